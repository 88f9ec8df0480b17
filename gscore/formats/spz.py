"""Niantic's SPZ: consecutive byte arrays in gzip (versions 2, 3) or zstd (version 4).

Source: the layout published with github.com/nianticlabs/spz. Positions are 24-bit fixed point, log
scales, colours and SH coefficients bytes, rotations three bytes (2) or the three smallest
components in 32 bits (3, 4). Its axes are right-up-back.
"""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import ConfigError, FormatError
from ..io.files import atomic_write, read_bytes
from ..io.splat_rows import LOGIT_OF_BYTE, drawable, opacity_bytes
from ..smallest_three import smallest_three, with_largest
from ..splats import SH_REST_BY_DEGREE, Splats
from ..text_format import count_text, number
from ..transforms import transform_splats, unit_quats
from .axes import X, harmonic_signs
from .far_splats import without_far
from .splat_file import Decoded, SplatFormat, WriteOptions, colors_note
from .spz_records import (
    check_ratio,
    gunzip_exactly,
    gzip_quickly,
    placement,
    unzstd_exactly,
    zstd_quickly,
)

_MAGIC = b"NGSP"
VERSIONS = (3, 4)
"""Versions that can be written."""
_HEADER = struct.Struct("<4sIIBBBB")
_HEADER_4 = struct.Struct("<4sIIBBBBI12x")
_STREAM = struct.Struct("<QQ")
_ANTIALIASED, _EXTENDED = 1, 2
_MOST_BITS = 23
"""Most fraction bits of a position, of 24."""
_MOST_PLACE = 2**23 - 1
"""Largest fixed-point number of a position."""
_FINE = 2.0**-13
"""Step of positions that is fine enough, for `without_far`."""
_MOST_EXTENSIONS = 1 << 20
"""Most bytes of extensions that are read."""
_COLOR_SCALE = 0.15
_BYTES = np.arange(256, dtype=np.float64)
_COLOR = ((_BYTES / 255 - 0.5) / _COLOR_SCALE).astype(np.float32)
_SCALE = (_BYTES / 16 - 10).astype(np.float32)
_HARMONIC = ((_BYTES - 128) / 128).astype(np.float32)
_SIGNS = np.array([1, -1, -1], np.float32)
"""Signs of positions and quaternion vectors between right-up-back and right-down-front."""
_ROTATION_STEPS = 511
_BLOCK = 1 << 17


@dataclass(frozen=True)
class _Header:
    version: int
    count: int
    degree: int
    bits: int
    flags: int

    @property
    def sizes(self) -> list[int]:
        """Bytes of the arrays, in order."""
        rotation = 3 if self.version == 2 else 4
        return [
            self.count * each for each in (9, 1, 3, 3, rotation, 3 * SH_REST_BY_DEGREE[self.degree])
        ]


def decode_spz(path: Path, raw: bytes | memoryview) -> Decoded:
    """Decode the bytes of an SPZ file; `path` is for messages.

    Raises:
        FormatError: they are not SPZ, of an unknown version, or damaged.
        BackendError: version 4 without the package zstandard.
    """
    if bytes(raw[:2]) == b"\x1f\x8b":
        header, arrays, matrix = _inflated(path, raw)
    elif bytes(raw[:4]) == _MAGIC and len(raw) >= _HEADER.size:
        header, arrays, matrix = _streams(path, raw)
    else:
        raise _damaged(path, "it does not begin as one")
    splats = _unpack(path, header, arrays)
    if matrix is not None:
        splats = transform_splats(splats, matrix @ np.diag([*_SIGNS, 1.0]))
    return Decoded(
        splats=splats,
        layout=f"SPZ {header.version}",
        antialiased=bool(header.flags & _ANTIALIASED),
    )


def encode_spz(
    splats: Splats, *, antialiased: bool, version: int
) -> tuple[bytes, list[str], np.ndarray]:
    """Bytes of an SPZ file, notes on changed splats, and the stored positions [N, 3] before
    rounding.

    Raises:
        ConfigError: the version cannot be written, or there are too many splats.
        BackendError: version 4 without the package zstandard.
    """
    if version not in VERSIONS:
        raise ConfigError(f"SPZ is written in version 3 or 4, got {version!r}.")
    if len(splats) >= 2**32:
        raise ConfigError("SPZ stores 4,294,967,295 splats at most.")
    splats, notes = without_far(splats, _step, _FINE, "SPZ")
    bits, farthest = _fraction_bits(splats.means)
    if farthest > _MOST_PLACE:
        notes.append("SPZ stores positions up to 8,388,607 units; those beyond were moved there.")
    notes += _clamped(splats)
    arrays = _pack(splats, bits)
    flags = _ANTIALIASED if antialiased else 0
    head = (_MAGIC, version, len(splats), splats.sh_degree, bits, flags)
    if version == 3:
        return gzip_quickly([_HEADER.pack(*head, 0), *arrays]), notes, splats.means
    arrays = [array for array in arrays if len(array)]
    streams = [zstd_quickly(array) for array in arrays]
    table = b"".join(_STREAM.pack(len(s), len(a)) for s, a in zip(streams, arrays, strict=True))
    header = _HEADER_4.pack(*head, len(streams), _HEADER_4.size)
    return b"".join([header, table, *streams]), notes, splats.means


def _header(path: Path, raw: bytes | memoryview) -> _Header:
    """Fields common to all versions, checked."""
    if len(raw) < _HEADER.size:
        raise _damaged(path, f"its header of {_HEADER.size} bytes is truncated")
    magic, version, count, degree, bits, flags, _ = _HEADER.unpack_from(raw)
    if magic != _MAGIC:
        raise _damaged(path, "it does not begin as one")
    if version not in (2, 3, 4):
        raise FormatError(
            f"{path} is an SPZ file of version {version}; versions 2, 3 and 4 are read. Export it "
            f"again in one of these, or as a 3DGS PLY."
        )
    if degree not in SH_REST_BY_DEGREE:
        raise _damaged(path, f"it states SH degree {degree}, expected 0 to 4")
    if bits > _MOST_BITS:
        raise _damaged(path, f"it states {bits} bits of fraction in numbers of 24 bits")
    return _Header(version, count, degree, bits, flags)


_Content = tuple[_Header, list[memoryview], np.ndarray | None]
"""Header, arrays, and the matrix from the file's axes to right-down-front, if stated."""


def _inflated(path: Path, raw: bytes | memoryview) -> _Content:
    """Contents of versions 2 and 3."""
    what = f"{path} is a damaged SPZ file"
    header = _header(path, gunzip_exactly(what, raw, _HEADER.size, at_least=0))
    if header.version == 4:
        raise _damaged(path, "it is of version 4, but within gzip")
    extra = _MOST_EXTENSIONS if header.flags & _EXTENDED else 0
    whole = memoryview(
        gunzip_exactly(
            what,
            raw,
            _HEADER.size + sum(header.sizes) + extra,
            at_least=_HEADER.size + sum(header.sizes),
        )
    )
    arrays, rest = _split(whole[_HEADER.size :], header.sizes)
    return header, arrays, placement(path, rest)


def _streams(path: Path, raw: bytes | memoryview) -> _Content:
    """Contents of version 4, and of uncompressed versions 2 and 3."""
    view = memoryview(raw)
    header = _header(path, view)
    if header.version < 4:
        body = view[_HEADER.size :]
        if len(body) < sum(header.sizes):
            words = count_text(header.count, "splat")
            raise _damaged(path, f"{words} take more than its {number(len(view))} bytes")
        return header, _split(body, header.sizes)[0], None
    if len(view) < _HEADER_4.size:
        raise _damaged(path, "its header is truncated")
    streams, start = _HEADER_4.unpack_from(view)[6:]
    first = start + streams * _STREAM.size
    sizes = [size for size in header.sizes if size]
    # Blender's importer requires six streams, so some programs also write an empty one.
    if streams not in (len(sizes), len(header.sizes)) or not _HEADER_4.size <= start:
        raise _damaged(path, f"it has {streams} streams, expected {len(sizes)}")
    if first > len(view):
        raise _damaged(path, "its stream table is truncated")
    check_ratio(f"{path} is a damaged SPZ file", len(view), sum(sizes))
    matrix = placement(path, view[_HEADER_4.size : start])
    arrays, at = [], first
    for index in range(streams):
        packed, size = _STREAM.unpack_from(view, start + index * _STREAM.size)
        expected = sizes[index] if index < len(sizes) else 0
        if size != expected or packed > len(view) - at:
            raise _damaged(
                path, f"stream {index + 1} states {size} bytes in {packed}, expected {expected}"
            )
        what = f"{path} is a damaged SPZ file"
        arrays.append(unzstd_exactly(what, view[at : at + packed], size))
        at += packed
    arrays += [memoryview(b"")] * (len(header.sizes) - len(arrays))
    return header, arrays, matrix


def _split(view: memoryview, sizes: list[int]) -> tuple[list[memoryview], memoryview]:
    arrays = []
    for size in sizes:
        arrays.append(view[:size])
        view = view[size:]
    return arrays, view


def _unpack(path: Path, header: _Header, arrays: list[memoryview]) -> Splats:
    count = header.count
    places, alphas, colors, scales, rotations, rest = (
        np.frombuffer(array, np.uint8) for array in arrays
    )
    shN = _HARMONIC[rest.reshape(count, SH_REST_BY_DEGREE[header.degree], 3)]
    if header.degree:
        shN *= harmonic_signs(header.degree, X)[:, None]
    unpack = _first_three if header.version == 2 else _smallest_three
    return drawable(
        path,
        means=_fixed_point(places.reshape(count, 3, 3)) * (_SIGNS * np.float32(2.0**-header.bits)),
        quats=unpack(rotations),
        scales=_SCALE[scales].reshape(count, 3),
        opacities=LOGIT_OF_BYTE[alphas],
        sh0=_COLOR[colors].reshape(count, 3),
        shN=shN,
    )


def _fixed_point(parts: np.ndarray) -> np.ndarray:
    """[N, 3] float32 from signed 3-byte integers, little endian."""
    high = parts[..., 2].view(np.int8).astype(np.int32) << 16
    return (high | parts[..., 1].astype(np.int32) << 8 | parts[..., 0]).astype(np.float32)


def _first_three(packed: np.ndarray) -> np.ndarray:
    """[N, 4] wxyz from bytes for x, y, z; w is positive."""
    vector = packed.reshape(-1, 3).astype(np.float32) / 127.5 - 1
    quats = np.empty((len(vector), 4), np.float32)
    quats[:, 0] = np.sqrt(np.maximum(0, 1 - (vector**2).sum(axis=1)))
    quats[:, 1:] = vector * _SIGNS
    return quats


def _smallest_three(packed: np.ndarray) -> np.ndarray:
    """[N, 4] wxyz from 2 bits for the index of the largest of x, y, z, w, and sign and size of the
    others."""
    words = np.frombuffer(packed, "<u4")
    parts = np.empty((len(words), 3), np.float32)
    for k in range(3):
        field = words >> np.uint32(20 - 10 * k)
        size = (field & np.uint32(_ROTATION_STEPS)).astype(np.float32)
        sign = 1 - 2 * ((field >> np.uint32(9)) & np.uint32(1)).astype(np.float32)
        parts[:, k] = sign * size * np.float32(np.sqrt(0.5) / _ROTATION_STEPS)
    quats = with_largest(words >> np.uint32(30), parts)[:, [3, 0, 1, 2]]
    quats[:, 1:] *= _SIGNS
    return quats


def _fraction_bits(means: np.ndarray) -> tuple[int, float]:
    """Most fraction bits with which positions [N, 3] fit, at least 0, and the largest position."""
    farthest = float(np.abs(means).max(initial=0))
    bits = _MOST_BITS
    while bits > 0 and farthest * 2.0**bits > _MOST_PLACE:
        bits -= 1
    return bits, farthest


def _step(low: np.ndarray, high: np.ndarray, middle: np.ndarray) -> float:
    """Step of positions in world units, for `without_far`."""
    return 2.0 ** -_fraction_bits(np.stack([low, high]))[0]


def _clamped(splats: Splats) -> list[str]:
    """Notes on numbers outside the ranges of SPZ."""
    notes = []
    if note := colors_note(splats.sh0, float(_COLOR[0]), float(_COLOR[-1]), "SPZ"):
        notes.append(note)
    beyond = int(((splats.scales < -10.03) | (splats.scales > 5.97)).any(axis=1).sum())
    if beyond:
        notes.append(
            f"Sizes of {count_text(beyond, 'splat')} outside SPZ's range, 0.000045 to 365, "
            f"became its nearest sizes."
        )
    wide = int((np.abs(splats.shN) > 1.004).any(axis=(1, 2)).sum())
    if wide:
        notes.append(
            f"SH coefficients of {count_text(wide, 'splat')} outside SPZ's range, -1 to 1, "
            f"became its nearest values."
        )
    return notes


@np.errstate(over="ignore")  # values beyond the range of a byte are clipped
def _pack(splats: Splats, bits: int) -> list[bytes]:
    """The arrays in order, packed in blocks."""
    blocks = [slice(at, at + _BLOCK) for at in range(0, len(splats), _BLOCK)]
    signs = harmonic_signs(splats.sh_degree, X)[:, None]
    parts = [
        (_pack_places(splats.means[b], bits) for b in blocks),
        (opacity_bytes(splats.opacities[b]) for b in blocks),
        (_to_bytes(splats.sh0[b] * (_COLOR_SCALE * 255) + 127.5) for b in blocks),
        (_to_bytes((splats.scales[b] + 10) * 16) for b in blocks),
        (_pack_rotations(splats.quats[b]) for b in blocks),
        (_to_bytes(splats.shN[b] * (128 * signs) + 128) for b in blocks),
    ]
    return [b"".join(part.tobytes() for part in array) for array in parts]


def _to_bytes(values: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _pack_places(means: np.ndarray, bits: int) -> np.ndarray:
    """[N, 3, 3] bytes of fixed-point positions."""
    fixed = np.rint(means.astype(np.float64) * _SIGNS * 2.0**bits)
    fixed = np.clip(fixed, -_MOST_PLACE - 1, _MOST_PLACE).astype("<i4")
    return fixed.view(np.uint8).reshape(-1, 3, 4)[..., :3]


def _pack_rotations(quats: np.ndarray) -> np.ndarray:
    """[N] uint32, as `_smallest_three` reads them."""
    unit = unit_quats(quats.astype(np.float32))[:, [1, 2, 3, 0]] * np.append(_SIGNS, np.float32(1))
    largest, parts = smallest_three(unit)
    sizes = np.rint(np.abs(parts) * (_ROTATION_STEPS * np.sqrt(2)))
    sizes = np.minimum(sizes, _ROTATION_STEPS).astype(np.uint32)
    words = largest.astype(np.uint32)
    for k in range(3):
        sign = (parts[:, k] < 0).astype(np.uint32)
        words = words << np.uint32(10) | sign << np.uint32(9) | sizes[:, k]
    return words.astype("<u4")


def _damaged(path: Path, why: str) -> FormatError:
    return FormatError(f"{path} is a damaged SPZ file: {why}. Copy or export it again.")


def _write(path: Path, splats: Splats, options: WriteOptions) -> list[str]:
    raw, notes, _ = encode_spz(splats, antialiased=options.antialiased, version=options.spz_version)
    atomic_write(path, raw)
    return notes


SPZ = SplatFormat(
    key="spz",
    name="SPZ",
    endings=(".spz",),
    recognizes=lambda path, sample: _MAGIC in (sample.head[:4], sample.inflated[:4]),
    read=lambda path: decode_spz(path, read_bytes(path)),
    write=_write,
    most_degree=4,
    keeps_origin=False,
)
