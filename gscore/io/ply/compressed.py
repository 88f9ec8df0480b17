"""Compressed PLY of SuperSplat: decoding, 256 splats per chunk, 16 bytes per splat.

Public format: element `chunk` has the bounds of positions, log scales and colours of 256 splats;
element `vertex` four uint32 per splat; the optional element `sh` one byte per coefficient.
"""

from pathlib import Path

import numpy as np

from ...errors import FormatError
from ...sh import rgb_to_sh0
from ...smallest_three import with_largest
from ...text_format import count_text
from ..splat_rows import LOGIT_OF_BYTE
from .elements import columns

CHUNK = 256
"""Splats per chunk."""
_ENDS = ("min", "max")
_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")


def is_compressed(elements: dict[str, np.ndarray]) -> bool:
    """True if the elements of a PLY file are a compressed splat model."""
    vertex = elements.get("vertex")
    return vertex is not None and "packed_position" in (vertex.dtype.names or ())


def decompress(path: Path, elements: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Decode the packed elements.

    Args:
        path: For error messages.
        elements: Elements of the file.

    Returns:
        Raw parameters as float32: means [N, 3], quats [N, 4] wxyz, scales [N, 3] log, opacities [N]
        logit, sh0 [N, 3], rest [N, 3(K-1)] channel-major as in an ordinary PLY.

    Raises:
        FormatError: an element or property is missing or sizes disagree.
    """
    vertex = elements["vertex"]
    chunk = elements.get("chunk", np.zeros(0, [("none", "f4")]))
    count = len(vertex)
    need = [f"{end}_{what}{axis}" for what in ("", "scale_") for end in _ENDS for axis in "xyz"]
    colors = [f"{end}_{axis}" for end in _ENDS for axis in "rgb"]
    has_colors = any(name in (chunk.dtype.names or ()) for name in colors)
    missing = [n for n in _PACKED if not _has(vertex, n, "iu")]
    missing += [n for n in need + colors * has_colors if not _has(chunk, n, "iuf")]
    if missing or len(chunk) != -(-count // CHUNK):
        raise FormatError(
            f"{path} is a damaged compressed splat PLY: {count_text(len(chunk), 'chunk')} for "
            f"{count_text(count, 'splat')} "
            f"(expected {-(-count // CHUNK)}), missing properties: {', '.join(missing) or 'none'}. "
            f"Export it again."
        )
    packed = [vertex[name].astype(np.uint32) for name in _PACKED]
    of = np.arange(count) // CHUNK
    rgb = np.stack([_unorm(packed[3], shift, 8) for shift in (24, 16, 8)], axis=1)
    if has_colors:
        rgb = _lerp(chunk, "{}_{}", "rgb", of, rgb)
    return {
        "means": _lerp(chunk, "{}_{}", "xyz", of, _unpack_11_10_11(packed[0])),
        "quats": _unpack_rotation(packed[1]),
        "scales": _lerp(chunk, "{}_scale_{}", "xyz", of, _unpack_11_10_11(packed[2])),
        "opacities": LOGIT_OF_BYTE[packed[3] & np.uint32(255)],
        "sh0": rgb_to_sh0(rgb).astype(np.float32),
        "rest": _unpack_rest(path, elements.get("sh"), count),
    }


def _has(table: np.ndarray, name: str, kinds: str) -> bool:
    return name in (table.dtype.names or ()) and table.dtype[name].kind in kinds


def _unorm(values: np.ndarray, shift: int, bits: int) -> np.ndarray:
    top = (1 << bits) - 1
    return ((values >> np.uint32(shift)) & np.uint32(top)).astype(np.float64) / top


def _unpack_11_10_11(values: np.ndarray) -> np.ndarray:
    fields = [_unorm(values, 21, 11), _unorm(values, 11, 10), _unorm(values, 0, 11)]
    return np.stack(fields, axis=1)


def _lerp(chunk: np.ndarray, pattern: str, axes: str, of: np.ndarray, t: np.ndarray) -> np.ndarray:
    """[N, 3] float32: t in [0, 1] between the chunk's bounds."""
    low = columns(chunk, [pattern.format("min", axis) for axis in axes]).astype(np.float64)[of]
    high = columns(chunk, [pattern.format("max", axis) for axis in axes]).astype(np.float64)[of]
    return (low * (1 - t) + high * t).astype(np.float32)


def _unpack_rotation(values: np.ndarray) -> np.ndarray:
    """[N, 4] float32 wxyz: 2 bits for the index of the largest component, 3 x 10 for the others."""
    others = np.stack([_unorm(values, shift, 10) for shift in (20, 10, 0)], axis=1)
    others = (others - 0.5) * np.sqrt(2.0)
    return with_largest(values >> np.uint32(30), others).astype(np.float32)


def _unpack_rest(path: Path, table: np.ndarray | None, count: int) -> np.ndarray:
    if table is None:
        return np.zeros((count, 0), np.float32)
    names = table.dtype.names or ()
    if len(table) != count or set(names) != {f"f_rest_{k}" for k in range(len(names))}:
        raise FormatError(
            f"{path} is a damaged compressed splat PLY: element sh has {len(table)} rows and the "
            f"properties {', '.join(names[:4])}..., expected {count} rows of f_rest_0 onwards. "
            f"Export it again."
        )
    out = np.empty((count, len(names)), np.float32)
    for k in range(
        len(names)
    ):  # one at a time: all of them in float64 take twice the memory of the result
        raw = columns(table, [f"f_rest_{k}"])[:, 0]
        # 0 and 255 decode to the ends of the range, all others to the middle of their step.
        unit = np.where(raw == 0, 0.0, np.where(raw == 255, 1.0, (raw + 0.5) / 256))
        out[:, k] = (unit - 0.5) * 8
    return out
