"""PlayCanvas' SOG reader: textures of one byte per value and meta.json, in a ZIP or a folder.

Source: the published specification of version 2 (developer.playcanvas.com, "The SOG Format"); axes
are those of a 3DGS PLY, as in the programs that write it.
"""

import io
import zipfile
import zlib
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DatasetError, FormatError, GsError
from ..io.file_sample import FileSample
from ..io.files import read_bytes
from ..io.splat_rows import LOGIT_OF_BYTE, drawable
from ..json_text import parse_json
from ..quoting import quoted
from ..smallest_three import with_largest
from ..splats import SH_REST_BY_DEGREE
from ..text_format import count_text, number
from . import textures
from .parts import check_part, parts_of
from .sog_writing import ANTIALIASED, CHECKS, FIRST_TAG, META, PALETTE_WIDTH, parts_in, write_sog
from .splat_file import Decoded, SplatFormat, origin_in
from .textures import CODEBOOK_SIZE

_MOST_META = 1 << 22
_MOST_SPLATS_A_BYTE = 16
"""Most splats per byte of all textures, plus the slack. Lower bits of positions are noise, so
captures have less than one; four million equal splats on a regular grid have 2.5."""
_SLACK = 1 << 16
_MOST_RATIO = 64
"""Largest ratio of unpacked to packed bytes of a texture, which is compressed already."""
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
                f"{path} needs the file {quoted(name)} next to it. {error}"
            ) from error

    return fetch


def _from_zip(path: Path, archive: zipfile.ZipFile) -> _Fetch:
    metas = [info for info in archive.infolist() if info.filename.rpartition("/")[2] == META]
    if not metas:
        raise _damaged(path, f"it contains no {META}")
    folder = min(metas, key=lambda info: len(info.filename)).filename[: -len(META)]

    def fetch(name: str) -> bytes:
        try:
            info = archive.getinfo(folder + name)
        except KeyError:
            raise _damaged(path, f"it contains no {quoted(name)}") from None
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
    fetch, count = meta.checked(fetch), meta.count
    names = [("means", 0), ("means", 1), ("scales", 0), ("quats", 0), ("sh0", 0)]
    files = [fetch(meta.file(*name)) for name in names]
    if count > _MOST_SPLATS_A_BYTE * sum(map(len, files)) + _SLACK:
        raise _damaged(
            path, f"it states {count_text(count, 'splat')} in {number(sum(map(len, files)))} bytes"
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
    return Decoded(splats=splats, layout="SOG 2", antialiased=meta.antialiased, origin=meta.origin)


class _Meta:
    """A meta.json, whose values are checked on access."""

    def __init__(self, path: Path, raw: bytes) -> None:
        self.path = path
        if len(raw) > _MOST_META:
            raise _damaged(path, f"its {META} has {len(raw)} bytes")
        try:
            content = parse_json(raw)
        except (ValueError, UnicodeDecodeError) as error:
            raise _damaged(path, f"its {META} is not JSON ({error})") from error
        if not isinstance(content, dict):
            raise _damaged(path, f"its {META} is not a JSON object")
        self._content = content
        version = content.get("version")
        if version != 2 or isinstance(version, bool):
            stated = "1" if version is None else quoted(version)
            raise FormatError(
                f"{path} is a SOG of version {stated}; version 2 is read. Write it again with "
                f"splat-transform, or export a 3DGS PLY."
            )
        self.count = self._whole(content, "count", 0, 2**31)
        self.origin = origin_in(content, partial(_damaged, path))
        self.antialiased = content.get("antialias") is True or content.get("model") == ANTIALIASED

    @property
    def has_harmonics(self) -> bool:
        return self._content.get("shN") is not None

    def checked(self, fetch: _Fetch) -> _Fetch:
        """`fetch`, with a check of each file against its CRC-32, if one is stated."""
        asset = self._content.get("asset")
        stated = asset.get(CHECKS) if isinstance(asset, dict) else None
        checks = stated if isinstance(stated, dict) else {}

        def fetched(name: str) -> bytes:
            content = fetch(name)
            check_part(self.path, name, content, checks.get(name))
            return content

        return fetched

    def file(self, section: str, index: int) -> str:
        """File name of a texture."""
        names = self._section(section).get("files")
        name = names[index] if isinstance(names, list) and index < len(names) else None
        if not isinstance(name, str):
            raise _damaged(self.path, f"{section} names no file {index + 1}")
        return name

    def codebook(self, section: str) -> np.ndarray:
        """[256] float32; missing entries are NaN."""
        book = self.numbers(section, "codebook")
        if not 0 < len(book) <= CODEBOOK_SIZE:
            raise _damaged(self.path, f"the codebook of {section} has {len(book)} numbers")
        return np.pad(book, (0, CODEBOOK_SIZE - len(book)), constant_values=np.nan)

    def numbers(self, section: str, key: str) -> np.ndarray:
        """A list of numbers, [n] float32."""
        values = self._section(section).get(key)
        if not isinstance(values, list) or not all(
            isinstance(v, int | float) and not isinstance(v, bool) for v in values
        ):
            raise _damaged(self.path, f"{section} has no list of numbers {key}")
        with np.errstate(over="ignore"):
            return np.array(values, np.float64).astype(np.float32)

    def whole(self, section: str, key: str, low: int, high: int) -> int:
        """An integer from `low` to below `high`."""
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
    """[N, 3] float32, from 16-bit steps of sign(v) ln(|v| + 1) between bounds."""
    first, last = meta.numbers("means", "mins"), meta.numbers("means", "maxs")
    if len(first) != 3 or len(last) != 3:
        raise _damaged(meta.path, "means has no three mins and maxs")
    steps = high[:, :3].astype(np.float32) * 256 + low[:, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        logs = first + (last - first) * (steps / 65535)
        return np.copysign(np.expm1(np.abs(logs)), logs).astype(np.float32)


def _quats(pixels: np.ndarray) -> np.ndarray:
    """[N, 4] wxyz from three bytes, -sqrt(1/2) to sqrt(1/2), and the index of the largest component
    in the fourth; the identity if that index is invalid."""
    three = (pixels[:, :3].astype(np.float32) / 255 - 0.5) * np.float32(np.sqrt(2))
    named = pixels[:, 3] >= FIRST_TAG
    three[~named] = 0
    return with_largest(np.where(named, pixels[:, 3], FIRST_TAG) - FIRST_TAG, three)


def _harmonics(meta: _Meta, fetch: _Fetch) -> np.ndarray:
    """[N, K-1, 3]: each splat has the index of a row of a palette of codebook entries."""
    if not meta.has_harmonics:
        return np.zeros((meta.count, 0, 3), np.float32)
    bands = meta.whole("shN", "bands", 0, 4)
    rows = meta.whole("shN", "count", 0, 2**16 + 1)
    width = SH_REST_BY_DEGREE[bands]
    if not width or not meta.count:
        return np.zeros((meta.count, width, 3), np.float32)
    names = [meta.file("shN", index) for index in range(2)]
    lines = -(-rows // PALETTE_WIDTH)
    pixels = textures.decode_texture(
        f"{meta.path}: {names[0]}", fetch(names[0]), lines * PALETTE_WIDTH * width
    )
    if pixels.shape[1] != PALETTE_WIDTH * width:
        raise _damaged(
            meta.path,
            f"{quoted(names[0])} is {pixels.shape[1]} pixels wide, expected "
            f"{PALETTE_WIDTH * width} for {bands} bands",
        )
    labels = textures.decode_texture(f"{meta.path}: {names[1]}", fetch(names[1]), meta.count)
    labels = labels.reshape(-1, 4)[: meta.count].astype(np.intp)
    labels = labels[:, 0] | labels[:, 1] << 8
    if labels.max(initial=0) >= rows:
        raise _damaged(meta.path, f"a label names row {labels.max()} of a palette of {rows}")
    colors = meta.codebook("shN")[pixels.reshape(-1, width, 4)[:rows, :, :3]]
    return colors[labels]


def _damaged(path: Path, why: str) -> FormatError:
    return FormatError(f"{path} is a damaged SOG: {why}. {_GAP}")


def _textures_of(path: Path) -> Iterable[Path]:
    """Textures listed in a meta.json, or all textures in the folder of a new one."""
    if path.name != META:
        return ()
    return parts_of(path, parts_in) or path.parent.glob("*.webp")


SOG = SplatFormat(
    key="sog",
    name="SOG",
    endings=(".sog", META),
    recognizes=_is_sog,
    read=_read,
    write=write_sog,
    part_files=_textures_of,
)
