"""OpenUSD's ParticleField3DGaussianSplat, reader and writer through Pixar's library (usd-core).

Source: the schema UsdVol of OpenUSD 26.03. Sizes are linear, opacities from 0 to 1; axes are those
of the stage. Files are written right-up-back, in prims that turn the up axis of the splats to Y.
"""

import logging
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BackendError, FormatError
from ..extras import need
from ..io.file_sample import FileSample
from ..io.files import atomic_write, check_readable
from ..io.ply.comments import stated_up
from ..io.ply.splats import read_ply
from ..io.splat_rows import linear_scales, opacities_of
from ..json_text import parse_json
from ..sh import sh_count
from ..splats import Splats, cut_degree
from ..transforms import unit_quats
from . import usd_reading
from .axes import UP, UPRIGHT, X, half_turn, harmonic_signs, upright_matrix
from .splat_file import ORIGIN, Decoded, SplatFormat, WriteOptions
from .usd_reading import MARK, TYPE, usd_library

_REACH = 3.0
"""Standard deviations within the extent."""
_SECONDS, _BYTES_A_SECOND = 30.0, 2e6
"""Timeout of reading: a constant, plus time by file size."""

_log = logging.getLogger(__name__)


def _is_usd(path: Path, sample: FileSample) -> bool:
    return sample.head.startswith((b"PXR-USDC", b"#usda")) or sample.is_zip_of(b".usd")


def _read(path: Path) -> Decoded:
    """Read a file in a separate process, because a damaged file can crash Pixar's library or make
    it loop for ever."""
    usd_library()
    check_readable(path)
    with tempfile.TemporaryDirectory(prefix="gscore-") as folder:
        made = Path(folder, "splats.ply")
        facts = _in_child(path, made)
        for warning in facts["warnings"]:
            _log.warning("%s", warning)
        if facts["error"]:
            raise FormatError(facts["error"])
        splats = read_ply(made)
    origin = None if facts["origin"] is None else np.array(facts["origin"], np.float64)
    return Decoded(
        splats=splats,
        layout="USD",
        antialiased=facts["antialiased"],
        origin=origin,
        comments=tuple(facts["comments"]),
    )


def _in_child(path: Path, made: Path) -> dict[str, Any]:
    """Result of `usd_reading` after it has written the splats as a PLY."""
    command = [sys.executable, "-P", "-m", usd_reading.__name__, str(path.absolute()), str(made)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    size = path.stat().st_size
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_SECONDS + size / _BYTES_A_SECOND,
            env=environment,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise _unreadable(path, f"took longer than {error.timeout:.0f} s") from error
    except OSError as error:
        raise BackendError(f"USD is read in a separate process, which failed: {error}") from error
    if done.returncode:
        raise _unreadable(path, f"ended with code {done.returncode}")
    return parse_json(done.stdout.splitlines()[-1])


def _unreadable(path: Path, how: str) -> FormatError:
    return FormatError(
        f"{path} is a damaged USD file: Pixar's library {how}. Copy or export it again."
    )


def _write(path: Path, splats: Splats, options: WriteOptions) -> list[str]:
    usd_library()
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
    """A stage, Y up, with the splats and their proxy below one prim, so that transforms that other
    stages put on it leave those of the splats."""
    Usd, UsdGeom, Vt = (need(f"pxr.{name}", "USD") for name in ("Usd", "UsdGeom", "Vt"))
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Scene").GetPrim())
    if options.proxy is not None:
        _add_proxy(stage, "/Scene/Proxy", options)
    prim = getattr(usd_library(), TYPE).Define(stage, "/Scene/Splats")
    vectors = Vt.Vec3fArray.FromNumpy
    # SH coefficients take the most memory: they are converted first and freed before other copies.
    prim.CreateRadianceSphericalHarmonicsDegreeAttr(splats.sh_degree)
    prim.CreateRadianceSphericalHarmonicsCoefficientsAttr(vectors(_turned_harmonics(splats)))
    splats = half_turn(cut_degree(splats, 0), X)
    unit = unit_quats(splats.quats)
    scales = linear_scales(splats.scales)
    prim.CreatePositionsAttr(vectors(splats.means))
    prim.CreateOrientationsAttr(Vt.QuatfArray.FromNumpy(unit[:, [1, 2, 3, 0]]))
    prim.CreateScalesAttr(vectors(scales))
    prim.CreateOpacitiesAttr(Vt.FloatArray.FromNumpy(opacities_of(splats.opacities)))
    prim.CreateExtentAttr(vectors(_extent(splats.means, scales)))
    _stand_up(prim, options)
    if options.antialiased:
        prim.GetPrim().SetCustomDataByKey(MARK, True)
    if options.origin is not None:
        stated = need("pxr.Gf", "USD").Vec3d(*options.origin.tolist())
        prim.GetPrim().SetCustomDataByKey(ORIGIN, stated)
    return stage


def _stand_up(prim: Any, options: WriteOptions) -> None:
    """Turn a prim from the up axis of the splats to that of the stage; the usual axis already is
    that in right-up-back."""
    up = stated_up(options.comments)
    if up not in UPRIGHT or up == "-Y":
        return
    UsdGeom, Gf = need("pxr.UsdGeom", "USD"), need("pxr.Gf", "USD")
    rows = np.eye(4)
    rows[:3, :3] = upright_matrix(up).T  # for row vectors
    UsdGeom.Xformable(prim).AddTransformOp().Set(Gf.Matrix4d(*rows.ravel().tolist()))
    prim.GetPrim().SetCustomDataByKey(UP, up)


def _add_proxy(stage: Any, path: str, options: WriteOptions) -> None:
    """A mesh with the purpose of a guide, which programs draw on request only."""
    UsdGeom, Vt = need("pxr.UsdGeom", "USD"), need("pxr.Vt", "USD")
    assert options.proxy is not None
    mesh = UsdGeom.Mesh.Define(stage, path)
    places = (options.proxy_vertices * [1, -1, -1]).astype(np.float32)
    corners = np.ascontiguousarray(options.proxy.triangles, np.int32)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(places))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(corners.ravel()))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(corners), 3, np.int32)))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreatePurposeAttr(UsdGeom.Tokens.guide)
    _stand_up(mesh, options)
    if len(places):
        ends = np.stack([places.min(axis=0), places.max(axis=0)])
        mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(ends))


def _turned_harmonics(splats: Splats) -> np.ndarray:
    """SH coefficients [N * K, 3] in the axes of the stage, including degree 0."""
    harmonics = np.empty((len(splats), sh_count(splats.sh_degree), 3), np.float32)
    harmonics[:, :1] = splats.sh0
    np.multiply(splats.shN, harmonic_signs(splats.sh_degree, X)[:, None], out=harmonics[:, 1:])
    return harmonics.reshape(-1, 3)


def _extent(means: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """[2, 3]: corners of a box around all splats."""
    if not len(means):
        return np.zeros((2, 3), np.float32)
    with np.errstate(over="ignore"):
        reach = _REACH * scales.max(axis=1, keepdims=True)
        ends = [(means - reach).min(axis=0), (means + reach).max(axis=0)]
    return np.stack(ends).astype(np.float32)


USD = SplatFormat(
    key="usd",
    name="USD",
    endings=(".usd", ".usdc", ".usda", ".usdz"),
    recognizes=_is_usd,
    read=_read,
    write=_write,
    most_degree=4,
    keeps_proxy=True,
)
