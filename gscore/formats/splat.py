"""antimatter15's `.splat`: rows of 32 bytes, no header, no spherical harmonics.

Source: the public layout of github.com/antimatter15/splat: position and size as three float32 each,
colour and opacity as four bytes, and a quaternion wxyz as bytes q 128 + 128.
"""

from pathlib import Path

import numpy as np

from ..errors import FormatError
from ..io.file_sample import FileSample
from ..io.files import atomic_write, read_bytes
from ..io.splat_rows import LOGIT_OF_BYTE, drawable, linear_scales, log_scales, opacity_bytes
from ..sh import rgb_to_sh0, sh0_to_rgb
from ..splats import Splats
from ..transforms import unit_quats
from .splat_file import Decoded, SplatFormat, WriteOptions, colors_note

_ROW = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
_COLOR = rgb_to_sh0(np.arange(256) / 255).astype(np.float32)
_BLOCK = 1 << 18
_SAMPLED = 64
_LARGEST = 1e6


def _is_splat(path: Path, sample: FileSample) -> bool:
    """Detect by name or first rows, as the format has no signature."""
    if sample.size % _ROW.itemsize or not sample.size:
        return sample.ending == ".splat"
    if sample.ending == ".splat":
        return True
    rows = np.frombuffer(sample.head[: _SAMPLED * _ROW.itemsize], _ROW)
    lengths = np.linalg.norm((rows["quat"].astype(np.float32) - 128) / 128, axis=1)
    sizes, means = rows["scale"], rows["mean"]
    plausible = np.isfinite(means).all() and np.abs(means).max() < _LARGEST
    plausible = plausible and np.isfinite(sizes).all() and (sizes > 0).all()
    return bool(plausible and sizes.max() < _LARGEST and (np.abs(lengths - 1) < 0.05).all())


def _read(path: Path) -> Decoded:
    raw = read_bytes(path)
    if len(raw) % _ROW.itemsize or not raw:
        raise FormatError(
            f"{path} is not a complete .splat file: it has {len(raw)} bytes, expected rows of "
            f"{_ROW.itemsize} bytes only. Copy or export it again."
        )
    rows = np.frombuffer(raw, _ROW)
    splats = drawable(
        path,
        means=np.ascontiguousarray(rows["mean"]),
        quats=(rows["quat"].astype(np.float32) - 128) / 128,
        scales=log_scales(rows["scale"]),
        opacities=LOGIT_OF_BYTE[rows["rgba"][:, 3]],
        sh0=_COLOR[rows["rgba"][:, :3]],
        shN=np.zeros((len(rows), 0, 3), np.float32),
    )
    return Decoded(splats=splats, layout=".splat")


def _write(path: Path, splats: Splats, options: WriteOptions) -> list[str]:
    parts = (slice(at, at + _BLOCK) for at in range(0, len(splats), _BLOCK))
    atomic_write(path, lambda file: file.writelines(_rows(splats, part) for part in parts))
    note = colors_note(splats.sh0, float(_COLOR[0]), float(_COLOR[-1]), ".splat")
    return [note] if note else []


def _rows(splats: Splats, part: slice) -> bytes:
    quats = splats.quats[part]
    rows = np.empty(len(quats), _ROW)
    rows["mean"] = splats.means[part]
    rows["scale"] = linear_scales(splats.scales[part])
    with np.errstate(over="ignore"):
        rows["rgba"][:, :3] = np.clip(np.rint(255 * sh0_to_rgb(splats.sh0[part, 0])), 0, 255)
    rows["rgba"][:, 3] = opacity_bytes(splats.opacities[part])
    rows["quat"] = np.clip(np.rint(unit_quats(quats) * 128 + 128), 0, 255)
    return rows.tobytes()


SPLAT = SplatFormat(
    key="splat",
    name="antimatter15's .splat",
    endings=(".splat",),
    recognizes=_is_splat,
    read=_read,
    write=_write,
    most_degree=0,
    keeps_antialiased=False,
    keeps_origin=False,
)
