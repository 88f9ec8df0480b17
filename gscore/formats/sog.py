"""PlayCanvas' SOG: textures of one byte a value beside a meta.json, in a ZIP archive or a folder.

Source: the published specification of version 2 (developer.playcanvas.com, "The SOG Format") and,
for axes, the programs that write it: those of a 3DGS PLY.
"""

import io
import json
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .._version import __version__
from ..errors import ConfigError, DatasetError, FormatError, GsError
from ..io.file_sample import FileSample
from ..io.files import atomic_write, read_bytes
from ..io.splat_rows import LOGIT_OF_BYTE, drawable, opacity_bytes
from ..json_text import parse_json
from ..nearby import morton_order
from ..shown import quoted
from ..smallest_three import smallest_three, with_largest
from ..splats import SH_REST_BY_DEGREE, Splats
from ..words import count_words, number
from . import textures
from .codebook import CODEBOOK_SIZE, codebook, nearest_entries, palette
from .far_splats import cut_extremes, without_far
from .splat_file import Decoded, SplatFormat, WriteOptions

META = "meta.json"
_PALETTE_WIDTH = 64
"""Rows of a palette beside each other in its texture."""
_MOST_META = 1 << 22
_MOST_SPLATS_A_BYTE = 16
"""Of all textures together, beyond the slack. Lower bits of positions are noise, so captures have
less than one; four million on an even grid that are equal otherwise have 2.5."""
_SLACK = 1 << 16
_MOST_RATIO = 64
"""Of unpacked to packed bytes of a texture, which is packed already."""
_FIRST_TAG = 252
_FINE = 2.0**-11
"""Step of positions that is fine enough, as `without_far` asks for it."""
_LARGEST = {"scales": 80.0, "sh0": 16.0, "shN": 4.0}
"""Of log scales and SH coefficients: the codebooks of all splats grow coarse with their ends."""
_ANTIALIASED = "antialiased"
"""What splat-transform writes as the model's kind; before, a SOG had `antialias`."""
_GAP = "Copy or export it again."
_BROKEN_ZIP = (
    zipfile.BadZipFile,
    zlib.error,
    NotImplementedError,
    RuntimeError,
    EOFError,
    OSError,
    ValueError,
    OverflowError,
    KeyError,
)

_Fetch = Callable[[str], bytes]


def _is_sog(path: Path, sample: FileSample) -> bool:
    if path.name == META or sample.ending == ".json":
        return b'"means"' in sample.head and b'"quats"' in sample.head
    return sample.is_zip_of(META.encode(), b".webp")


def _read(path: Path) -> Decoded:
    if path.suffix.lower() == ".json":
        return _decode(path, read_bytes(path), _from_folder(path))
    try:
        with zipfile.ZipFile(io.BytesIO(read_bytes(path))) as archive:
            fetch = _from_zip(path, archive)
            return _decode(path, fetch(META), fetch)
    except GsError:  # some are ValueErrors and RuntimeErrors too
        raise
    except _BROKEN_ZIP as error:
        raise FormatError(f"{path} is a damaged ZIP archive of a SOG: {error}. {_GAP}") from error


def _from_folder(path: Path) -> _Fetch:
    def fetch(name: str) -> bytes:
        if Path(name).name != name or "\\" in name or name in ("", ".", ".."):
            raise _damaged(path, f"it names the file {quoted(name)}, which leaves its folder")
        try:
            return read_bytes(path.parent / name)
        except DatasetError as error:
            raise DatasetError(
                f"{path} needs the file {quoted(name)} beside it. {error}"
            ) from error

    return fetch


def _from_zip(path: Path, archive: zipfile.ZipFile) -> _Fetch:
    found = [info for info in archive.infolist() if info.filename.rpartition("/")[2] == META]
    if not found:
        raise _damaged(path, f"it holds no {META}")
    folder = min(found, key=lambda info: len(info.filename)).filename[: -len(META)]

    def fetch(name: str) -> bytes:
        try:
            info = archive.getinfo(folder + name)
        except KeyError:
            raise _damaged(path, f"it holds no {quoted(name)}") from None
        if info.flag_bits & 1:
            raise FormatError(
                f"{path} is an encrypted ZIP archive of a SOG. Unpack it with its password, and "
                f"give the folder."
            )
        if info.file_size > _MOST_RATIO * info.compress_size + _SLACK:
            raise _damaged(
                path,
                f"{quoted(name)} states {info.file_size} bytes in {info.compress_size} packed ones",
            )
        with archive.open(info) as file:
            return file.read(info.file_size)

    return fetch


def _decode(path: Path, raw: bytes, fetch: _Fetch) -> Decoded:
    meta = _Meta(path, raw)
    count = meta.count
    names = [("means", 0), ("means", 1), ("scales", 0), ("quats", 0), ("sh0", 0)]
    files = [fetch(meta.file(*name)) for name in names]
    if count > _MOST_SPLATS_A_BYTE * sum(map(len, files)) + _SLACK:
        raise _damaged(
            path, f"it states {count_words(count, 'splat')} in {number(sum(map(len, files)))} bytes"
        )
    low, high, sizes, turns, colors = (
        textures.decode_texture(f"{path}: {meta.file(*name)}", file, count).reshape(-1, 4)[:count]
        for name, file in zip(names, files, strict=True)
    )
    splats = drawable(
        path,
        means=_means(meta, low, high),
        quats=_quats(turns),
        scales=meta.codebook("scales")[sizes[:, :3]],
        opacities=LOGIT_OF_BYTE[colors[:, 3]],
        sh0=meta.codebook("sh0")[colors[:, :3]],
        shN=_harmonics(meta, fetch),
    )
    return Decoded(splats=splats, layout="SOG 2", antialiased=meta.antialiased)


class _Meta:
    """A meta.json, whose values are checked when they are asked for."""

    def __init__(self, path: Path, raw: bytes) -> None:
        self.path = path
        if len(raw) > _MOST_META:
            raise _damaged(path, f"its {META} has {len(raw)} bytes")
        try:
            content = parse_json(raw)
        except (ValueError, UnicodeDecodeError) as error:
            raise _damaged(path, f"its {META} is no JSON ({error})") from error
        if not isinstance(content, dict):
            raise _damaged(path, f"its {META} is no JSON object")
        self._content = content
        version = content.get("version")
        if version != 2 or isinstance(version, bool):
            stated = "1" if version is None else quoted(version)
            raise FormatError(
                f"{path} is a SOG of version {stated}; version 2 is read. Write it again with "
                f"splat-transform, or export a 3DGS PLY."
            )
        self.count = self._whole(content, "count", 0, 2**31)
        self.antialiased = content.get("antialias") is True or content.get("model") == _ANTIALIASED

    @property
    def has_harmonics(self) -> bool:
        return self._content.get("shN") is not None

    def file(self, section: str, index: int) -> str:
        """The name of a texture."""
        names = self._section(section).get("files")
        name = names[index] if isinstance(names, list) and index < len(names) else None
        if not isinstance(name, str):
            raise _damaged(self.path, f"{section} names no file {index + 1}")
        return name

    def codebook(self, section: str) -> np.ndarray:
        """[256] float32; entries that it does not have are NaN."""
        found = self.numbers(section, "codebook")
        if not 0 < len(found) <= CODEBOOK_SIZE:
            raise _damaged(self.path, f"the codebook of {section} has {len(found)} numbers")
        return np.pad(found, (0, CODEBOOK_SIZE - len(found)), constant_values=np.nan)

    def numbers(self, section: str, key: str) -> np.ndarray:
        """[n] float32."""
        values = self._section(section).get(key)
        if not isinstance(values, list) or not all(
            isinstance(v, int | float) and not isinstance(v, bool) for v in values
        ):
            raise _damaged(self.path, f"{section} has no list of numbers {key}")
        with np.errstate(over="ignore"):
            return np.array(values, np.float64).astype(np.float32)

    def whole(self, section: str, key: str, low: int, high: int) -> int:
        """A whole number from `low` to below `high`."""
        return self._whole(self._section(section), key, low, high)

    def _whole(self, place: dict[str, Any], key: str, low: int, high: int) -> int:
        value = place.get(key)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value < high:
            raise _damaged(self.path, f"{key} is {quoted(value)}, expected {low} to {high - 1}")
        return value

    def _section(self, name: str) -> dict[str, Any]:
        section = self._content.get(name)
        if not isinstance(section, dict):
            raise _damaged(self.path, f"its {META} has no {name}")
        return section


def _means(meta: _Meta, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """[N, 3]: steps of 16 bits between bounds, of sign(v) ln(|v| + 1)."""
    first, last = meta.numbers("means", "mins"), meta.numbers("means", "maxs")
    if len(first) != 3 or len(last) != 3:
        raise _damaged(meta.path, "means has no three mins and maxs")
    steps = high[:, :3].astype(np.float32) * 256 + low[:, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        logs = first + (last - first) * (steps / 65535)
        return np.copysign(np.expm1(np.abs(logs)), logs).astype(np.float32)


def _quats(pixels: np.ndarray) -> np.ndarray:
    """[N, 4] wxyz: three bytes from -sqrt(1/2) to sqrt(1/2), the largest component named by the
    fourth; the identity where that names none."""
    three = (pixels[:, :3].astype(np.float32) / 255 - 0.5) * np.float32(np.sqrt(2))
    named = pixels[:, 3] >= _FIRST_TAG
    three[~named] = 0
    return with_largest(np.where(named, pixels[:, 3], _FIRST_TAG) - _FIRST_TAG, three)


def _harmonics(meta: _Meta, fetch: _Fetch) -> np.ndarray:
    """[N, K-1, 3]: each splat names a row of a palette of codebook entries."""
    if not meta.has_harmonics:
        return np.zeros((meta.count, 0, 3), np.float32)
    bands = meta.whole("shN", "bands", 0, 4)
    rows = meta.whole("shN", "count", 0, 2**16 + 1)
    width = SH_REST_BY_DEGREE[bands]
    if not width or not meta.count:
        return np.zeros((meta.count, width, 3), np.float32)
    names = [meta.file("shN", index) for index in range(2)]
    lines = -(-rows // _PALETTE_WIDTH)
    pixels = textures.decode_texture(
        f"{meta.path}: {names[0]}", fetch(names[0]), lines * _PALETTE_WIDTH * width
    )
    if pixels.shape[1] != _PALETTE_WIDTH * width:
        raise _damaged(
            meta.path,
            f"{quoted(names[0])} is {pixels.shape[1]} pixels wide, expected "
            f"{_PALETTE_WIDTH * width} for {bands} bands",
        )
    labels = textures.decode_texture(f"{meta.path}: {names[1]}", fetch(names[1]), meta.count)
    labels = labels.reshape(-1, 4)[: meta.count].astype(np.intp)
    labels = labels[:, 0] | labels[:, 1] << 8
    if labels.max(initial=0) >= rows:
        raise _damaged(meta.path, f"a label names row {labels.max()} of a palette of {rows}")
    found = meta.codebook("shN")[pixels.reshape(-1, width, 4)[:rows, :, :3]]
    return found[labels]


def _write(path: Path, splats: Splats, options: WriteOptions) -> list[str]:
    if not textures.fits(len(splats)):
        raise ConfigError(f"{path}: SOG holds 268 million splats at most.")
    meta, pictures, notes = _textures(splats)
    meta |= {"antialias": True, "model": _ANTIALIASED} if options.antialiased else {}
    files = textures.encode_all(pictures)
    text = json.dumps(meta).encode()
    if path.suffix.lower() == ".json":
        for name, raw in files.items():
            atomic_write(path.parent / name, raw)
        atomic_write(path, text)  # last, so that it names what is there
        return notes
    packed = io.BytesIO()
    # Stored, not deflated: WebP is packed already, and some readers know nothing else.
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_STORED) as archive:
        for name, raw in {META: text, **files}.items():
            archive.writestr(zipfile.ZipInfo(name), raw)
    atomic_write(path, packed.getvalue())
    return notes


def _textures(splats: Splats) -> tuple[dict[str, Any], dict[str, np.ndarray], list[str]]:
    """The content of meta.json, pictures by name, and sentences on what they do not hold."""
    splats, notes = without_far(splats, _step, _FINE, "SOG")
    for field, most in _LARGEST.items():
        splats, cut = cut_extremes(splats, field, most)
        if cut:
            notes.append(
                f"{count_words(cut, 'splat')} had {field} far beyond usual ones, which were cut: "
                f"SOG has 256 values for those of all splats."
            )
    order = morton_order(splats.means)
    scales, colors = codebook(splats.scales), codebook(splats.sh0)
    low, high, ends = _pack_means(splats.means[order])
    alphas = opacity_bytes(splats.opacities[order])
    pictures = {
        "means_l.webp": _texture(low),
        "means_u.webp": _texture(high),
        "scales.webp": _texture(nearest_entries(scales, splats.scales[order])),
        "quats.webp": _texture(*_pack_quats(splats.quats[order])),
        "sh0.webp": _texture(nearest_entries(colors, splats.sh0[order, 0]), alphas),
    }
    meta: dict[str, Any] = {
        "version": 2,
        "asset": {"generator": f"gscore {__version__}"},
        "count": len(splats),
        "means": {**ends, "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": scales.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": colors.tolist(), "files": ["sh0.webp"]},
    }
    if splats.sh_degree and len(splats):
        rows, labels = palette(splats.shN[order].reshape(len(splats), -1))
        book = codebook(rows)
        meta["shN"] = {
            "count": len(rows),
            "bands": splats.sh_degree,
            "codebook": book.tolist(),
            "files": ["shN_centroids.webp", "shN_labels.webp"],
        }
        pictures["shN_centroids.webp"] = _palette_texture(nearest_entries(book, rows))
        pictures["shN_labels.webp"] = _label_texture(labels)
    return meta, pictures, notes


def _pack_means(means: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict[str, list[float]]]:
    """Lower and upper bytes [N, 3], and the bounds between which they are steps."""
    logs = _logs(means)
    ends = np.zeros((2, 3))
    if len(means):
        ends = np.stack([logs.min(axis=0), logs.max(axis=0)])
    width = np.where(ends[1] > ends[0], ends[1] - ends[0], 1)
    steps = np.rint((logs - ends[0]) / width * 65535).astype(np.uint16)
    bounds = {"mins": ends[0].tolist(), "maxs": ends[1].tolist()}
    return (steps & 255).astype(np.uint8), (steps >> 8).astype(np.uint8), bounds


def _logs(means: np.ndarray) -> np.ndarray:
    """sign(v) ln(|v| + 1), float64."""
    return np.copysign(np.log1p(np.abs(means.astype(np.float64))), means)


def _step(low: np.ndarray, high: np.ndarray, middle: np.ndarray) -> float:
    """Of positions in units, as `without_far` asks for it."""
    return float(((_logs(high) - _logs(low)) / 65535 * (np.abs(middle) + 1)).max())


def _pack_quats(quats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Three bytes and a tag of each quaternion, as `_quats` reads them."""
    unit = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    largest, three = smallest_three(unit)
    parts = three * np.sqrt(0.5) + 0.5
    return np.rint(np.clip(parts, 0, 1) * 255).astype(np.uint8), (_FIRST_TAG + largest).astype(
        np.uint8
    )


def _texture(colors: np.ndarray, alphas: np.ndarray | int = 255) -> np.ndarray:
    """[H, W, 4] of bytes [N, 3] and alphas [N]."""
    width, height = textures.size_for(len(colors))
    pixels = np.zeros((height * width, 4), np.uint8)
    pixels[:, 3] = 255
    pixels[: len(colors), :3] = colors
    pixels[: len(colors), 3] = alphas
    return pixels.reshape(height, width, 4)


def _palette_texture(indices: np.ndarray) -> np.ndarray:
    """64 rows [D] beside each other, a pixel for the three channels of a coefficient."""
    width = indices.shape[1] // 3
    lines = -(-len(indices) // _PALETTE_WIDTH)
    pixels = np.full((lines * _PALETTE_WIDTH, width, 4), 255, np.uint8)
    pixels[: len(indices), :, :3] = indices.reshape(-1, width, 3)
    return pixels.reshape(lines, _PALETTE_WIDTH * width, 4)


def _label_texture(labels: np.ndarray) -> np.ndarray:
    parts = np.zeros((len(labels), 3), np.uint8)
    parts[:, 0], parts[:, 1] = labels & 255, labels >> 8
    return _texture(parts)


def _damaged(path: Path, why: str) -> FormatError:
    return FormatError(f"{path} is a damaged SOG: {why}. {_GAP}")


SOG = SplatFormat(
    key="sog",
    name="SOG",
    endings=(".sog", META),
    holds=_is_sog,
    read=_read,
    write=_write,
    beside=lambda path: path.parent.glob("*.webp") if path.name == META else (),
)
