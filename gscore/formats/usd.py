"""OpenUSD's ParticleField3DGaussianSplat, read and written by Pixar's library (usd-core).

Source: the schema UsdVol of OpenUSD 26.03. Sizes are linear, opacities from 0 to 1; axes are those
of the stage. Files are written right-up-back, with Y up.
"""

import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BackendError, FormatError, ShapeError
from ..extras import need
from ..io.file_sample import FileSample
from ..io.files import atomic_write, check_readable
from ..io.splat_rows import drawable, linear_scales, log_scales, logits, opacities_of, whole_bands
from ..sh import sh_count
from ..splats import Splats
from ..transforms import transform_splats
from .axes import X, half_turn, harmonic_signs
from .joined import cut_degree, joined
from .splat_file import Decoded, SplatFormat, WriteOptions

_TYPE = "ParticleField3DGaussianSplat"
_MARK = "antialiased"
"""In the custom data of a prim; the schema has no place for it."""
_Y_OF_Z = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""From a stage with Z up to one with Y up."""
_REACH = 3.0
"""Standard deviations within the extent."""
_MOST_DEGREE = 4


def _is_usd(path: Path, sample: FileSample) -> bool:
    return sample.head.startswith((b"PXR-USDC", b"#usda")) or sample.is_zip_of(b".usd")


def _library() -> Any:
    """The schemas, of a release that knows splats.

    Raises:
        BackendError: usd-core is not installed, or older than 26.03.
    """
    found = need("pxr.UsdVol", "USD")
    if not hasattr(found, _TYPE):
        raise BackendError(
            "This usd-core does not know Gaussian splats; version 26.3 does: "
            'pip install --upgrade "usd-core>=26.3"'
        )
    return found


def _read(path: Path) -> Decoded:
    _library()
    Usd, Tf, UsdGeom = need("pxr.Usd", "USD"), need("pxr.Tf", "USD"), need("pxr.UsdGeom", "USD")
    check_readable(path)  # in our words
    try:
        stage = Usd.Stage.Open(str(path))
        prims = [prim for prim in stage.Traverse() if prim.GetTypeName() == _TYPE]
        parts = [_splats(path, prim) for prim in prims]
        matrices = [_matrix(prim) for prim in prims]
        marks = [prim.GetCustomDataByKey(_MARK) is True for prim in prims]
        has_z_up = UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
    except (Tf.ErrorException, RuntimeError) as error:
        reason = (str(error) or type(error).__name__).strip().splitlines()[-1].strip()
        raise FormatError(
            f"{path} is a damaged USD file: {reason} Copy or export it again."
        ) from error
    if not parts:
        raise FormatError(
            f"{path} is a USD scene without splats: it has no prim of the type {_TYPE}. Give the "
            f"file of a trained model."
        )
    up = _Y_OF_Z if has_z_up else np.eye(4)
    try:
        placed = [
            part if np.array_equal(up @ matrix, np.eye(4)) else transform_splats(part, up @ matrix)
            for part, matrix in zip(parts, matrices, strict=True)
        ]
    except ShapeError as error:
        raise FormatError(f"{path}: a prim cannot be placed. {error}") from error
    return Decoded(splats=half_turn(joined(placed), X), layout="USD", antialiased=all(marks))


def _matrix(prim: Any) -> np.ndarray:
    """[4, 4] of a prim to the stage, that acts on column vectors."""
    UsdGeom, Usd = need("pxr.UsdGeom", "USD"), need("pxr.Usd", "USD")
    found = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.EarliestTime())
    return np.array(found, np.float64).T


def _splats(path: Path, prim: Any) -> Splats:
    means = _rows(path, prim, "positions", 3)
    if means is None:
        raise _damaged(path, prim, "has no positions")
    count = len(means)
    # The schema's defaults for what is not there.
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
        shN=np.ascontiguousarray(whole_bands(path, harmonics[:, 1:])),
    )


def _harmonics(path: Path, prim: Any, count: int) -> np.ndarray:
    """[N, K, 3], the constant one first; zero where there are none."""
    degree = prim.GetAttribute("radiance:sphericalHarmonicsDegree").Get()
    if not isinstance(degree, int) or not 0 <= degree <= _MOST_DEGREE:
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
    """[N, width] float32 of an attribute in float or in half, at its first time."""
    Usd = need("pxr.Usd", "USD")
    for attribute in (prim.GetAttribute(name), prim.GetAttribute(f"{name}h")):
        values = attribute.Get(Usd.TimeCode.EarliestTime()) if attribute else None
        if values is None or not len(values):
            continue
        found = np.asarray(values, np.float32).reshape(-1, width)
        if count is not None and len(found) < count:
            raise _damaged(path, prim, f"has {len(found)} {name}, expected {count}")
        return found[:count]
    return None if count != 0 else np.zeros((0, width), np.float32)


def _write(path: Path, splats: Splats, options: WriteOptions) -> list[str]:
    _library()
    UsdUtils = need("pxr.UsdUtils", "USD")
    stage = _stage(splats, options)
    with tempfile.TemporaryDirectory(prefix="gscore-") as folder:
        ending = ".usdc" if path.suffix.lower() in (".usd", ".usdz") else path.suffix.lower()
        made = Path(folder, f"splats{ending}")
        stage.GetRootLayer().Export(str(made))
        if path.suffix.lower() == ".usdz":
            packed = made.with_suffix(".usdz")
            UsdUtils.CreateNewUsdzPackage(str(made), str(packed))
            made = packed
        with made.open("rb") as source:
            atomic_write(path, lambda file: shutil.copyfileobj(source, file, 1 << 22))
    return []


def _stage(splats: Splats, options: WriteOptions) -> Any:
    """A stage with one prim, Y up."""
    Usd, UsdGeom, Vt = (need(f"pxr.{name}", "USD") for name in ("Usd", "UsdGeom", "Vt"))
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    prim = getattr(_library(), _TYPE).Define(stage, "/Splats")
    stage.SetDefaultPrim(prim.GetPrim())
    # Turned without the harmonics, of which a copy more would be the largest thing in memory.
    rest, splats = splats, half_turn(cut_degree(splats, 0), X)
    unit = splats.quats / np.linalg.norm(splats.quats, axis=1, keepdims=True)
    scales = linear_scales(splats.scales)
    harmonics = np.empty((len(splats), sh_count(rest.sh_degree), 3), np.float32)
    harmonics[:, :1] = splats.sh0
    np.multiply(rest.shN, harmonic_signs(rest.sh_degree, X)[:, None], out=harmonics[:, 1:])
    vectors = Vt.Vec3fArray.FromNumpy
    prim.CreatePositionsAttr(vectors(splats.means))
    prim.CreateOrientationsAttr(Vt.QuatfArray.FromNumpy(unit[:, [1, 2, 3, 0]]))
    prim.CreateScalesAttr(vectors(scales))
    prim.CreateOpacitiesAttr(Vt.FloatArray.FromNumpy(opacities_of(splats.opacities)))
    prim.CreateRadianceSphericalHarmonicsDegreeAttr(rest.sh_degree)
    prim.CreateRadianceSphericalHarmonicsCoefficientsAttr(vectors(harmonics.reshape(-1, 3)))
    prim.CreateExtentAttr(vectors(_extent(splats.means, scales)))
    if options.antialiased:
        prim.GetPrim().SetCustomDataByKey(_MARK, True)
    return stage


def _extent(means: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """[2, 3]: the corners of a box around all splats."""
    if not len(means):
        return np.zeros((2, 3), np.float32)
    reach = _REACH * scales.max(axis=1, keepdims=True)
    with np.errstate(over="ignore"):
        ends = [(means - reach).min(axis=0), (means + reach).max(axis=0)]
    return np.stack(ends).astype(np.float32)


def _damaged(path: Path, prim: Any, why: str) -> FormatError:
    return FormatError(
        f"{path} is a USD scene with damaged splats: {prim.GetPath()} {why}. Export it again."
    )


USD = SplatFormat(
    key="usd",
    name="USD",
    endings=(".usd", ".usdc", ".usda", ".usdz"),
    holds=_is_usd,
    read=_read,
    write=_write,
)
