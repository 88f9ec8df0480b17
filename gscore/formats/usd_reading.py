"""USD reader process: `python -m gscore.formats.usd_reading FILE PLY`, started by usd.py.

Writes the splats to PLY and one JSON object to stdout: error, antialiased, origin, comments,
warnings.
"""

import json
import logging
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BackendError, FormatError, GsError, ShapeError
from ..extras import need
from ..io.ply.comments import UP_AXIS
from ..io.ply.splats import write_splats
from ..io.splat_rows import drawable, log_scales, logits
from ..scene import checked_origin
from ..sh import MAX_DEGREE, sh_count
from ..splats import Splats
from ..text_format import count_text, number
from ..transforms import transform_splats
from ..warning_log import collected_warnings
from .axes import UP, UPRIGHT, X, half_turn, upright_matrix
from .joined import joined_files
from .splat_file import ORIGIN, Decoded

TYPE = "ParticleField3DGaussianSplat"
MARK = "antialiased"
"""Key in the custom data of a prim, as is the origin, because the schema has neither."""
_MOST_SPLATS_A_BYTE, _SLACK = 1, 1 << 16
"""Most splats per byte of a scene's files, since instances repeat splats, and the slack."""
_Y_OF_Z = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""Rotation from a stage with Z up to one with Y up."""
_TURNED = 1e-5
"""Largest difference of the entries of a rotation that is that of the writer."""

_log = logging.getLogger(__package__)  # __name__ is __main__ in the process


def export_to_ply(file: Path, ply: Path) -> dict[str, Any]:
    """Read a USD file, write its splats to a PLY, and return the JSON for stdout."""
    facts: dict[str, Any] = {"error": "", "antialiased": False, "origin": None, "comments": []}
    with collected_warnings() as warnings:
        try:
            decoded = read_usd(file)
            facts["antialiased"] = decoded.antialiased
            facts["origin"] = None if decoded.origin is None else decoded.origin.tolist()
            facts["comments"] = list(decoded.comments)
            write_splats(ply, decoded.splats)
        except GsError as error:
            facts["error"] = str(error)
    return facts | {"warnings": warnings}


def usd_library() -> Any:
    """The module pxr.UsdVol, of a release with the schema for splats.

    Raises:
        BackendError: usd-core is not installed, or older than 26.03.
    """
    library = need("pxr.UsdVol", "USD")
    if not hasattr(library, TYPE):
        raise BackendError(
            "This usd-core does not support Gaussian splats; version 26.3 does: "
            'pip install --upgrade "usd-core>=26.3"'
        )
    return library


def read_usd(path: Path) -> Decoded:
    """Splats of a file, in the axes of a 3DGS PLY.

    Raises:
        FormatError: it has none, or is damaged.
        BackendError: usd-core is not installed, or older than 26.03.
    """
    usd_library()
    Usd, Tf, UsdGeom = need("pxr.Usd", "USD"), need("pxr.Tf", "USD"), need("pxr.UsdGeom", "USD")
    try:
        stage = Usd.Stage.Open(str(path))
        parts, matrices, marks, origins, ups = [], [], [], [], []
        room = _MOST_SPLATS_A_BYTE * _bytes_of(stage) + _SLACK
        for prim, matrix in _placed(stage.GetPseudoRoot(), np.eye(4), None):
            parts.append(_splats(path, prim))
            matrices.append(matrix)
            ups.append(_up_of(prim))
            marks.append(prim.GetCustomDataByKey(MARK) is True)
            origins.append(_origin(path, prim))
            room -= len(parts[-1])
            if room < 0:
                raise _repeated(path, len(parts))
        if unread := stage.GetCompositionErrors():
            _log.warning(
                "%s is incomplete: %s of the scene cannot be read. %s",
                path,
                count_text(len(unread), "part"),
                str(unread[0]).strip(),
            )
        has_z_up = UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
    except (Tf.ErrorException, RuntimeError, UnicodeDecodeError) as error:
        raise FormatError(
            f"{path} is a damaged USD file: {_reason(error)} Copy or export it again."
        ) from error
    if not parts:
        raise FormatError(
            f"{path} is a USD scene without splats: it has no prim of the type {TYPE}. Give the "
            f"file of a trained model."
        )
    up = ups[0] if len(set(ups)) == 1 else ""
    to_world = _from_upright(up) @ (_Y_OF_Z if has_z_up else np.eye(4))
    try:
        placed = [
            part if np.array_equal(whole, np.eye(4)) else transform_splats(part, whole)
            for part, whole in zip(parts, (to_world @ matrix for matrix in matrices), strict=True)
        ]
    except ShapeError as error:
        raise FormatError(f"{path}: a prim cannot be placed. {error}") from error
    found = joined_files(
        [
            Decoded(splats=half_turn(part, X), layout="USD", antialiased=all(marks), origin=origin)
            for part, origin in zip(placed, origins, strict=True)
        ]
    )
    return replace(found, comments=(f"{UP_AXIS}{up}",) if up else ())


def _up_of(prim: Any) -> str:
    """The up axis by which the writer turned a prim; empty: none, or another program has changed
    the rotation."""
    up = prim.GetCustomDataByKey(UP)
    if not isinstance(up, str) or up not in UPRIGHT:
        return ""
    local = need("pxr.UsdGeom", "USD").Xformable(prim).GetLocalTransformation()
    turn = np.array(local, np.float64).T[:3, :3]
    return up if np.allclose(turn, upright_matrix(up), atol=_TURNED) else ""


def _from_upright(up: str) -> np.ndarray:
    """Matrix [4, 4] that undoes the rotation of the writer, after all that other programs add."""
    out = np.eye(4)
    if up:
        out[:3, :3] = upright_matrix(up).T
    return out


def _origin(path: Path, prim: Any) -> np.ndarray | None:
    """Local origin [3] of a prim, in the axes of a 3DGS PLY; None: none."""
    stated = prim.GetCustomDataByKey(ORIGIN)
    try:
        return None if stated is None else checked_origin([float(value) for value in stated])
    except (TypeError, ValueError) as error:
        raise _damaged(path, prim, f"misstates its origin, {error}") from error


def _reason(error: Exception) -> str:
    """Message of the library, which may contain bytes of the file that are not text."""
    try:
        text = str(error).strip()
    except UnicodeDecodeError:
        return "it has bytes that are not text."
    return text.splitlines()[-1].strip() if text else type(error).__name__


def _placed(root: Any, outer: np.ndarray, above: Any) -> Iterator[tuple[Any, np.ndarray]]:
    """Splat prims at and below a prim, including instances, each with its matrix [4, 4] to the
    stage, for column vectors.

    Args:
        root: First prim.
        outer: [4, 4] from `above` to the stage.
        above: The prim that matrices are relative to; None: the stage.
    """
    Usd, UsdGeom = need("pxr.Usd", "USD"), need("pxr.UsdGeom", "USD")
    cache = UsdGeom.XformCache(Usd.TimeCode.EarliestTime())

    def matrix_of(prim: Any) -> np.ndarray:
        if above is None:
            found = cache.GetLocalToWorldTransform(prim)
        else:
            found = cache.ComputeRelativeTransform(prim, above)[0]
        return outer @ np.array(found, np.float64).T

    walk = iter(Usd.PrimRange(root, Usd.TraverseInstanceProxies()))
    for prim in walk:
        if prim.IsA(UsdGeom.PointInstancer):
            walk.PruneChildren()
            yield from _of_points(UsdGeom.PointInstancer(prim), matrix_of(prim))
        elif prim.GetTypeName() == TYPE:
            yield prim, matrix_of(prim)


def _of_points(instancer: Any, matrix: np.ndarray) -> Iterator[tuple[Any, np.ndarray]]:
    """Like `_placed`, for the prototypes of a point instancer."""
    time = need("pxr.Usd", "USD").TimeCode.EarliestTime()
    prototypes = instancer.GetPrototypesRel().GetForwardedTargets()
    which = instancer.GetProtoIndicesAttr().Get(time)
    inner = instancer.ComputeInstanceTransformsAtTime(
        time, time, instancer.IncludeProtoXform, instancer.IgnoreMask
    )
    shown = instancer.ComputeMaskAtTime(time) or [True] * len(inner)
    for index, one, is_shown in zip(which or (), inner, shown, strict=True):
        if is_shown and 0 <= index < len(prototypes):
            prototype = instancer.GetPrim().GetStage().GetPrimAtPath(prototypes[index])
            outer = matrix @ np.array(one, np.float64).T
            if prototype:
                yield from _placed(prototype, outer, prototype)


def _bytes_of(stage: Any) -> int:
    """Bytes of all files of a stage."""
    files = {layer.realPath for layer in stage.GetUsedLayers()}
    return sum(Path(file).stat().st_size for file in files if Path(file).is_file())


def _repeated(path: Path, times: int) -> FormatError:
    return FormatError(
        f"{path} repeats its splats: its instances make {number(times)} prims and more from a "
        f"small file. Export it with each splat once, or as a 3DGS PLY."
    )


def _splats(path: Path, prim: Any) -> Splats:
    means = _rows(path, prim, "positions", 3)
    if means is None:
        raise _damaged(path, prim, "has no positions")
    count = len(means)
    # Missing attributes have the schema's defaults.
    quats = _rows(path, prim, "orientations", 4, count)
    scales = _rows(path, prim, "scales", 3, count)
    opacities = _rows(path, prim, "opacities", 1, count)
    if quats is None or scales is None or opacities is None:
        raise _damaged(path, prim, "lacks orientations, scales or opacities")
    harmonics = _harmonics(path, prim, count)
    return drawable(
        path,
        means=means,
        quats=quats[:, [3, 0, 1, 2]],
        scales=log_scales(scales),
        opacities=logits(opacities[:, 0]),
        sh0=np.ascontiguousarray(harmonics[:, 0]),
        shN=np.ascontiguousarray(harmonics[:, 1:]),
    )


def _harmonics(path: Path, prim: Any, count: int) -> np.ndarray:
    """[N, K, 3] SH coefficients, degree 0 first; zero if missing."""
    degree = prim.GetAttribute("radiance:sphericalHarmonicsDegree").Get()
    if not isinstance(degree, int) or not 0 <= degree <= MAX_DEGREE:
        raise _damaged(path, prim, f"states SH degree {degree}")
    found = _rows(path, prim, "radiance:sphericalHarmonicsCoefficients", 3)
    each = sh_count(degree)
    if found is None or not len(found):
        return np.zeros((count, 1, 3), np.float32)
    if len(found) < count * each:
        raise _damaged(path, prim, f"has {len(found)} SH coefficients, expected {count * each}")
    return found[: count * each].reshape(count, each, 3)


def _rows(
    path: Path, prim: Any, name: str, width: int, count: int | None = None
) -> np.ndarray | None:
    """[N, width] float32 of an attribute in float or half, at its first time."""
    Usd = need("pxr.Usd", "USD")
    for attribute in (prim.GetAttribute(name), prim.GetAttribute(f"{name}h")):
        values = attribute.Get(Usd.TimeCode.EarliestTime()) if attribute else None
        try:
            if values is None or not len(values):
                continue
            found = np.asarray(values, np.float32).reshape(-1, width)
        except (TypeError, ValueError) as error:  # a file may declare any type for it
            raise _damaged(path, prim, f"has {name} that are not rows of {width}") from error
        if count is not None and len(found) < count:
            raise _damaged(path, prim, f"has {len(found)} {name}, expected {count}")
        return found[:count]
    return None if count != 0 else np.zeros((0, width), np.float32)


def _damaged(path: Path, prim: Any, why: str) -> FormatError:
    return FormatError(
        f"{path} is a USD scene with damaged splats: {prim.GetPath()} {why}. Export it again."
    )


if __name__ == "__main__":
    sys.stdout.write(json.dumps(export_to_ply(Path(sys.argv[1]), Path(sys.argv[2]))) + "\n")
