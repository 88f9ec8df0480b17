"""mkkellogg's `.ksplat`: sections of splats in buckets, as floats, halves or bytes; read only.

Source: the layout of github.com/mkkellogg/GaussianSplats3D, version 0.1: a header of 4,096 bytes,
1,024 for each section, then for each section the sizes of its partly filled buckets, the centres of
all buckets, and its splats.
"""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError
from ..io.file_sample import FileSample
from ..io.files import read_bytes
from ..io.splat_rows import LOGIT_OF_BYTE, drawable, log_scales
from ..sh import rgb_to_sh0
from ..splats import SH_REST_BY_DEGREE, Splats
from ..text_format import count_text, number
from .joined import joined
from .splat_file import Decoded, SplatFormat

_HEADER = struct.Struct("<BBxxIIIIHxx3fff")
_HEADER_BYTES, _SECTION_BYTES = 4096, 1024
_SECTION = struct.Struct("<IIIIfHxxIIIIH")
_CENTRE_BYTES = 12
_LEVELS = (("<f4", "<f4"), ("<f2", "<f2"), ("<f2", "u1"))
"""Types of sizes and quaternions, and of SH coefficients, by compression level."""
_REACH = 1.5
"""Range of SH coefficients in bytes, if the header states none."""
_COLOR = rgb_to_sh0(np.arange(256) / 255).astype(np.float32)
_MOST_DEGREE = 3
_BAND_STARTS = (0, 3, 8, 15)


@dataclass(frozen=True)
class _File:
    path: Path
    raw: bytes
    sections: int
    level: int
    lowest: float
    highest: float


@dataclass(frozen=True)
class _Section:
    count: int
    room: int
    """Number of splats with allocated bytes."""
    bucket_size: int
    buckets: int
    block: float
    """Side of a bucket, world units."""
    centre_bytes: int
    steps: int
    """Steps of a position, from the centre of a bucket to its side."""
    full: int
    """Number of full buckets; the partial ones follow."""
    partial: int
    degree: int

    @property
    def head(self) -> int:
        """Bytes before the splats."""
        return 4 * self.partial + self.centre_bytes * self.buckets


def _is_ksplat(path: Path, sample: FileSample) -> bool:
    """Detect by ending, or by plausible sizes, as the format has no signature."""
    if sample.ending == ".ksplat":
        return True
    if sample.size < _HEADER_BYTES + _SECTION_BYTES:
        return False
    major, minor, room, stated, _, count, level, *_ = _HEADER.unpack_from(sample.head)
    sections = stated or room
    plausible = (major, minor) == (0, 1) and 0 < sections <= room <= 1 << 16 and count > 0
    if not plausible or level >= len(_LEVELS):
        return False
    least = _HEADER_BYTES + room * _SECTION_BYTES + count * _row(level, 0).itemsize
    return least <= sample.size


def _read(path: Path) -> Decoded:
    raw = read_bytes(path)
    if len(raw) < _HEADER_BYTES:
        raise _damaged(path, f"its header of {_HEADER_BYTES} bytes is truncated")
    major, minor, room, stated, _, count, level, *_, low, high = _HEADER.unpack_from(raw)
    sections = stated or room  # the number may be 0 if all of them are used
    if (major, minor) != (0, 1):
        raise FormatError(
            f"{path} is a .ksplat file of version {major}.{minor}; version 0.1 is read. Write it "
            f"again with GaussianSplats3D, or give the file it was made from."
        )
    if level >= len(_LEVELS):
        raise _damaged(path, f"it states the compression level {level}, expected 0 to 2")
    at = _HEADER_BYTES + room * _SECTION_BYTES
    if sections > room or at > len(raw):
        raise _damaged(path, f"it states {sections} of {room} sections in {len(raw)} bytes")
    file = _File(path, raw, sections, level, low or -_REACH, high or _REACH)
    parts, counts = [], []
    for index in range(sections):
        section = _section(file, index)
        size = section.head + section.room * _row(level, section.degree).itemsize
        if section.count > section.room or at + size > len(raw):
            words = count_text(section.count, "splat")
            raise _damaged(path, f"section {index + 1} of {words} goes on beyond its end")
        parts.append(_splats(file, section, at))
        counts.append(section.count)
        at += size
    total = sum(counts)
    if total != count or not count:
        raise _damaged(path, f"it states {count_text(count, 'splat')} and has {number(total)}")
    return Decoded(splats=joined(parts), layout=f".ksplat, compression {level}")


def _section(file: _File, index: int) -> _Section:
    fields = _SECTION.unpack_from(file.raw, _HEADER_BYTES + index * _SECTION_BYTES)
    count, room, size, buckets, block, centre, steps, _, full, partial, degree = fields
    if degree > _MOST_DEGREE:
        raise _damaged(file.path, f"section {index + 1} states SH degree {degree}")
    if file.level and centre < _CENTRE_BYTES:
        raise _damaged(file.path, f"section {index + 1} states {centre} bytes per bucket")
    return _Section(
        count=count,
        room=room,
        bucket_size=size,
        buckets=buckets,
        block=block,
        centre_bytes=centre,
        steps=steps or 32767,
        full=full,
        partial=partial,
        degree=degree,
    )


def _row(level: int, degree: int) -> np.dtype:
    number, harmonic = _LEVELS[level]
    fields: list[Any] = [
        ("mean", "<u2" if level else "<f4", 3),
        ("scale", number, 3),
        ("quat", number, 4),
        ("rgba", "u1", 4),
        ("rest", harmonic, 3 * SH_REST_BY_DEGREE[degree]),
    ]
    return np.dtype(fields)


def _splats(file: _File, section: _Section, at: int) -> Splats:
    rows = np.frombuffer(
        file.raw, _row(file.level, section.degree), section.count, at + section.head
    )
    with np.errstate(invalid="ignore", over="ignore"):
        return drawable(
            file.path,
            means=_means(file, section, at, rows["mean"]),
            quats=rows["quat"].astype(np.float32),
            scales=log_scales(rows["scale"].astype(np.float32)),
            opacities=LOGIT_OF_BYTE[rows["rgba"][:, 3]],
            sh0=_COLOR[rows["rgba"][:, :3]],
            shN=_harmonics(file, section.degree, rows["rest"]),
        )


def _means(file: _File, section: _Section, at: int, stored: np.ndarray) -> np.ndarray:
    """[N, 3]: floats, or steps from the centre of the splat's bucket."""
    if not file.level:
        return stored.astype(np.float32)
    sizes = np.frombuffer(file.raw, "<u4", section.partial, at).astype(np.int64)
    filled = section.full * section.bucket_size
    buckets = section.full + section.partial
    if buckets > section.buckets or filled + sizes.sum() < section.count:
        raise _damaged(
            file.path,
            f"its buckets are too small for the {count_text(section.count, 'splat')} of a section",
        )
    # Larger sizes have no effect.
    sizes = np.minimum(sizes, section.count)
    full = np.arange(min(filled, section.count)) // max(section.bucket_size, 1)
    left = section.count - len(full)
    partly = section.full + np.searchsorted(np.cumsum(sizes), np.arange(left), side="right")
    of = np.concatenate([full, partly])
    stride = (section.centre_bytes, 4)
    start = at + 4 * section.partial
    centres = np.ndarray((section.buckets, 3), "<f4", file.raw, start, stride)
    step = np.float32(section.block / 2 / section.steps)
    return (stored.astype(np.float32) - np.float32(section.steps)) * step + centres[of]


def _harmonics(file: _File, degree: int, stored: np.ndarray) -> np.ndarray:
    """[N, K-1, 3] from the file's order: per band all reds, then greens, then blues."""
    values = stored.astype(np.float32)
    if _LEVELS[file.level][1] == "u1":
        values = np.float32(file.lowest) + values * np.float32((file.highest - file.lowest) / 255)
    out = np.empty((len(values), SH_REST_BY_DEGREE[degree], 3), np.float32)
    for band in range(degree):
        first, last = _BAND_STARTS[band], _BAND_STARTS[band + 1]
        part = values[:, 3 * first : 3 * last].reshape(len(values), 3, last - first)
        out[:, first:last] = part.transpose(0, 2, 1)
    return out


def _damaged(path: Path, why: str) -> FormatError:
    return FormatError(f"{path} is a damaged .ksplat file: {why}. Copy or export it again.")


KSPLAT = SplatFormat(
    key="ksplat",
    name="mkkellogg's .ksplat",
    endings=(".ksplat",),
    recognizes=_is_ksplat,
    read=_read,
    write=None,
)
