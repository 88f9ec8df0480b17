"""Format registry: all splat formats, and functions that read and write files of any of them.

A format is a `SplatFormat` in its own module, listed in `FORMATS`.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

import numpy as np

from ..errors import ConfigError, DatasetError, FormatError
from ..io.file_sample import FileSample, sample_file
from ..io.files import is_file, reason
from ..io.mesh.files import TriangleMesh
from ..io.splat_rows import drawable_rows
from ..io.unsupported_formats import describe_unsupported
from ..quoting import brief
from ..scene import checked_origin, origin_text
from ..sh import MAX_DEGREE
from ..splats import SH_REST_BY_DEGREE, Splats, cut_degree
from ..text_format import count_text, number
from ..warning_log import collected_warnings
from . import gltf_splats, ksplat, ply, ply_compressed, sog, splat, spz, usd
from .splat_file import Decoded, SplatFile, SplatFormat, WriteOptions, WrittenFile

FORMATS: tuple[SplatFormat, ...] = (
    ply_compressed.COMPRESSED_PLY,
    ply.PLY,
    spz.SPZ,
    sog.SOG,
    gltf_splats.GLTF,
    gltf_splats.GLTF_SPZ,
    usd.USD,
    ksplat.KSPLAT,
    splat.SPLAT,
)
"""Formats in order of detection: those without a signature are last."""
SPLAT_ENDINGS = tuple(ending for one in FORMATS for ending in one.endings)
"""Endings of splat files, with the dot."""


def read_splat_file(path: str | Path) -> SplatFile:
    """Read a model of any format, detected by content, not by name.

    Args:
        path: The file; or the folder or the meta.json of an unpacked SOG.

    Returns:
        The model, always in the axes of a 3DGS PLY, and the metadata of the file.

    Raises:
        DatasetError: the file is missing or cannot be read.
        FormatError: it is in no supported format, has no splats, or is damaged.
        BackendError: a package that the format needs is not installed.
    """
    path = Path(path)
    file = _file_of(path)
    found = _format_of(file)
    with collected_warnings() as notes:
        decoded = found.read(file)
    return SplatFile(
        **vars(decoded),
        path=path,
        format=found.key,
        storage_bytes=_bytes_of(found, file),
        notes=tuple(notes),
    )


def read_splats(path: str | Path) -> Splats:
    """Read the splats of a file of any format; notes are logged as warnings.

    Means are relative to the file's local origin, if it states one: see `read_splat_file`.
    """
    return read_decoded(path).splats


def read_decoded(path: str | Path) -> Decoded:
    """Like `read_splats`, with the metadata of the file."""
    file = _file_of(Path(path))
    return _format_of(file).read(file)


def read_splat_parts(path: str | Path, rows: int) -> Iterator[Splats]:
    """Like `read_splats`, about `rows` splats at a time, all of one SH degree.

    A PLY is never completely in memory; other formats are.

    Raises:
        GsError: as `read_splat_file`.
    """
    file = _file_of(Path(path))
    found = _format_of(file)
    if found.read_parts is not None:
        yield from found.read_parts(file, rows)
        return
    splats = found.read(file).splats
    for at in range(0, len(splats), rows):
        yield splats.subset(np.arange(at, min(at + rows, len(splats))))


def is_antialiased(path: str | Path) -> bool:
    """True if a file marks its splats as trained with the anti-aliasing compensation.

    Raises:
        GsError: as `read_splat_file`.
    """
    file = _file_of(Path(path))
    found = _format_of(file)
    says = found.is_antialiased
    return says(file) if says else found.read(file).antialiased


def file_origin(path: str | Path) -> np.ndarray | None:
    """[3] float64, local origin stated by a file; None: none.

    Raises:
        GsError: as `read_splat_file`.
    """
    file = _file_of(Path(path))
    found = _format_of(file)
    return found.file_origin(file) if found.file_origin else found.read(file).origin


def write_splat_file(
    path: str | Path,
    splats: Splats,
    *,
    antialiased: bool = False,
    origin: np.ndarray | None = None,
    sh_degree: int | None = None,
    comments: tuple[str, ...] = (),
    spz_version: int = 3,
    proxy: TriangleMesh | None = None,
) -> WrittenFile:
    """Write a model in the format of the file's ending, completely or not at all.

    Args:
        path: The file; its ending is one of `SPLAT_ENDINGS`, and its folder is made.
        splats: The model, raw parameters in the axes of a 3DGS PLY.
        antialiased: Whether its splats need the anti-aliasing compensation.
        origin: [3], local origin of the means, in the coordinates of the capture; None: none.
        sh_degree: Highest SH degree to write; None: that of the model, limited by the format.
        comments: Comments, for formats that support them.
        spz_version: Version of SPZ: 3, which every reader supports, or 4, with zstd.
        proxy: Mesh in the coordinates of the capture, written hidden into glTF and USD, for shadows
            and collisions in other programs; None: none.

    Returns:
        The written file, with notes on data that the format cannot store.

    Raises:
        ConfigError: no format has this ending, or it is read only; there is no valid splat; or an
            option is invalid.
        GsError: the file cannot be written.
        BackendError: a package that the format needs is not installed.
    """
    path = Path(path)
    found = format_to_write(path)
    if sh_degree is not None and sh_degree not in SH_REST_BY_DEGREE:
        raise ConfigError(f"The SH degree must be 0 to {MAX_DEGREE}, got {sh_degree!r}.")
    if proxy is not None and not found.keeps_proxy:
        endings = ", ".join(end for one in FORMATS if one.keeps_proxy for end in one.endings)
        raise ConfigError(
            f"{brief(path)}: {found.name} has no meshes, so a proxy needs one of {endings}."
        )
    notes: list[str] = []
    most = min(splats.sh_degree, found.most_degree)
    kept = _drawable(splats, notes)
    if not len(kept):
        # An empty .splat has no bytes, and other programs refuse most empty files.
        raise ConfigError(
            f"There is no splat to write into {brief(path)}"
            f"{': none of them can be drawn' if notes else ''}. Give a model with splats."
        )
    kept = kept if sh_degree is None else cut_degree(kept, sh_degree)
    if kept.sh_degree > most:
        notes.append(
            f"{found.name} stores colours up to SH degree {most}; view dependence of higher "
            f"degrees is lost."
        )
        kept = cut_degree(kept, most)
    if antialiased and not found.keeps_antialiased:
        notes.append(
            f"{found.name} cannot mark splats as trained with antialiasing; set it in the renderer."
        )
    if origin is not None:
        origin = checked_origin(origin)
        if not found.keeps_origin:
            notes.append(
                f"{found.name} cannot store a local origin: add {origin_text(origin)} to "
                f"positions to get the coordinates of the capture."
            )
    options = WriteOptions(
        antialiased=antialiased,
        origin=origin,
        comments=tuple(comments),
        spz_version=spz_version,
        proxy=proxy,
    )
    assert found.write is not None
    notes += found.write(path, kept, options)
    return WrittenFile(
        path=path, format=found.key, storage_bytes=_bytes_of(found, path), notes=tuple(notes)
    )


def _drawable(splats: Splats, notes: list[str]) -> Splats:
    """The valid splats, because most formats quantise blocks of splats between their bounds, where
    one non-finite number would spoil its neighbours."""
    good = drawable_rows(splats)
    if dropped := len(splats) - len(good):
        notes.append(
            f"{number(dropped)} of {count_text(len(splats), 'splat')} had numbers that are "
            f"not finite or a zero quaternion; they are left out."
        )
    return good


def format_to_write(path: Path) -> SplatFormat:
    """Format of a file name, by its longest matching ending.

    Raises:
        ConfigError: there is none, or it is read only.
    """
    name = path.name.lower()
    matches = [
        (len(end), one)
        for one in FORMATS
        for end in one.endings
        if (name.endswith(end) if end.startswith(".") else name == end)
    ]
    if not matches:
        raise ConfigError(
            f"{brief(path)}: no format of splats has this ending. Choose one of "
            f"{', '.join(end for one in FORMATS if one.write for end in one.endings)}."
        )
    found = max(matches, key=lambda pair: pair[0])[1]
    if found.write is None:
        raise ConfigError(
            f"{brief(path)}: {found.name} is read, but not written. Choose one of "
            f"{', '.join(end for one in FORMATS if one.write for end in one.endings)}."
        )
    return found


def files_of(path: Path) -> set[Path]:
    """All files of a model: the file itself and its parts.

    Raises:
        GsError: as `read_splat_file`.
    """
    file = _file_of(path)
    return {file, *_format_of(file).part_files(file)}


def is_splat_file(path: Path) -> bool:
    """True if a file, or the folder of an unpacked SOG, is recognised as a splat model."""
    file = _file_of(path)
    try:
        return _known(file, _sample(file)) is not None
    except DatasetError:
        return False


def _file_of(path: Path) -> Path:
    """The file to read: for a folder its meta.json, if it has one."""
    inside = path / sog.META
    return inside if is_file(inside) else path


def _format_of(path: Path) -> SplatFormat:
    found = _known(path, _sample(path))
    if found is None:
        _refuse(path)
    return found


def _known(path: Path, sample: FileSample) -> SplatFormat | None:
    return next((one for one in FORMATS if one.recognizes(path, sample)), None)


def _sample(path: Path) -> FileSample:
    try:
        return sample_file(path)
    except (OSError, ValueError) as error:
        raise DatasetError(f"Cannot read {brief(path)}: {reason(error)}") from error


def _refuse(path: Path) -> NoReturn:
    raise FormatError(
        describe_unsupported(path)
        or f"{path} contains no splats in a supported format: {', '.join(SPLAT_ENDINGS)}. Choose "
        f"the point_cloud.ply that a 3D Gaussian Splatting trainer wrote, or export it again."
    )


def _bytes_of(kind: SplatFormat, file: Path) -> int:
    return sum(one.stat().st_size for one in (file, *kind.part_files(file)) if one.is_file())
