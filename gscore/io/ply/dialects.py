"""PLY dialects: raw splat parameters from the vertices of any program's PLY.

Sources: the official 3DGS layout; `filter_3D` as the code of Mip-Splatting applies it (Yu et al.
2024, section 4.1; also written by GOF and RaDe-GS); 2DGS (Huang et al. 2024), whose discs have two
scales; CloudCompare, which prefixes every property except positions and colours with `scalar_`.
"""

from pathlib import Path

import numpy as np

from ...errors import FormatError
from ...sh import rgb_to_sh0
from ..splat_rows import logits, whole_bands
from .elements import columns

POSITION = ["x", "y", "z"]
SCALE = ["scale_0", "scale_1", "scale_2"]
QUAT = ["rot_0", "rot_1", "rot_2", "rot_3"]
DC = ["f_dc_0", "f_dc_1", "f_dc_2"]
_RGB = ["red", "green", "blue"]
_FILTER = "filter_3D"
_PREFIX = "scalar_"
_DISC = np.float32(np.log(1e-6))
"""Log scale along the normal of a 2DGS disc, which has no thickness."""


def parameters_of(path: Path, table: np.ndarray) -> dict[str, np.ndarray]:
    """Raw parameters of an uncompressed vertex element, as `compressed.decompress` returns them.

    Raises:
        FormatError: it contains no splats, or its properties contradict each other.
    """
    table = _without_prefix(table)
    names = table.dtype.names or ()
    has_dc = all(name in names for name in DC)
    has_rgb = all(name in names for name in _RGB)
    missing = [n for n in (*POSITION, "opacity", *SCALE[:2], *QUAT) if n not in names]
    if not has_dc and not has_rgb:
        missing += [n for n in DC if n not in names]
    if missing:
        raise FormatError(
            f"{path} has no Gaussian splats: its vertices lack {', '.join(missing)}, so it is a "
            f"plain mesh or point cloud; choose the point_cloud.ply that a 3D Gaussian Splatting "
            f"trainer wrote."
        )
    scales = columns(table, [name for name in SCALE if name in names])
    opacities = columns(table, ["opacity"])[:, 0]
    if _FILTER in names:
        scales, opacities = _filtered(scales, opacities, columns(table, [_FILTER]))
    if scales.shape[1] == 2:
        scales = np.concatenate([scales, np.full((len(scales), 1), _DISC)], axis=1)
    return {
        "means": columns(table, POSITION),
        "quats": columns(table, QUAT),
        "scales": scales,
        "opacities": opacities,
        "sh0": columns(table, DC) if has_dc else _from_rgb(table),
        "rest": columns(table, _rest_names(path, names)),
    }


def rest_by_coefficient(path: Path, rest: np.ndarray) -> np.ndarray:
    """[N, K-1, 3] from channel-major [N, 3(K'-1)], truncated to whole bands up to degree 4.

    Raises:
        FormatError: the coefficients are not three channels.
    """
    count = rest.shape[1]
    if count % 3:
        raise FormatError(
            f"{path} has {count} properties f_rest_*, expected 0, 9, 24, 45 or 72 (three "
            f"colour channels of SH degree 0 to 4). Export it again."
        )
    by_channel = rest.reshape(len(rest), 3, count // 3).transpose(0, 2, 1)
    return np.ascontiguousarray(whole_bands(path, by_channel))


def _without_prefix(table: np.ndarray) -> np.ndarray:
    """The table with its property names restored from CloudCompare's."""
    names = table.dtype.names or ()
    short = [name.removeprefix(_PREFIX) for name in names]
    if len(set(short)) != len(names) or tuple(short) == names or table.dtype.hasobject:
        return table
    kinds = [table.dtype[name] for name in names]
    return table.view(np.dtype(list(zip(short, kinds, strict=True))))


def _filtered(
    scales: np.ndarray, opacities: np.ndarray, radius: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Log scales [N, 2 or 3] and opacity logits [N] of splats convolved with Gaussians of the
    radius [N, 1], which lowers the opacity; splats with the radius 0 keep their bits."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        squares = np.exp(2 * scales.astype(np.float64))
        wider = squares + radius.astype(np.float64) ** 2
        faded = np.sqrt((squares / wider).prod(axis=1))
        visible = logits(faded / (1 + np.exp(-opacities.astype(np.float64))))
        wide = (np.log(wider) / 2).astype(np.float32)
    kept = radius[:, 0] == 0
    return np.where(kept[:, None], scales, wide), np.where(kept, opacities, visible)


def _from_rgb(table: np.ndarray) -> np.ndarray:
    """[N, 3] SH coefficients of degree 0 from red, green and blue."""
    kind = table.dtype[_RGB[0]]
    top = float(np.iinfo(kind).max) if kind.kind in "iu" else 1.0
    return rgb_to_sh0(columns(table, _RGB) / top).astype(np.float32)


def _rest_names(path: Path, names: tuple[str, ...]) -> list[str]:
    """Names f_rest_0 to f_rest_{n-1} of all n such properties."""
    count = sum(1 for name in names if name.startswith("f_rest_"))
    rest = [f"f_rest_{k}" for k in range(count)]
    if any(name not in names for name in rest):
        raise FormatError(
            f"{path} has {count} properties f_rest_*, but they are not numbered 0 to {count - 1}. "
            f"Export it again."
        )
    return rest
