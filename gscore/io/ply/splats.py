"""PLY splats: reader of every dialect, writer of the official 3DGS layout."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ...errors import DatasetError, FormatError
from ...quoting import brief, quoted
from ...scene import checked_origin
from ...splats import SH_REST_BY_DEGREE, Splats
from ..files import atomic_write, open_regular, reason
from ..splat_rows import drawable, drawable_rows, warn_dropped_rows
from .compressed import decompress, is_compressed
from .dialects import DC, POSITION, QUAT, SCALE, parameters_of, rest_by_coefficient
from .elements import HEADER_END, HEADER_LIMIT, header_bytes, read_elements

MIP_COMMENT = "SplatRenderMode: mip"
"""Header comment of models trained with the anti-aliasing compensation."""
_ORIGIN = "gscore origin "
"""Start of the header comment with the local origin of the means."""
_ROWS_A_BLOCK = 1 << 15


def read_ply(path: str | Path) -> Splats:
    """Read a splat model; properties are found by name, in any order and among any others.

    Supports the official layout and its variants (no normals, SH degree 0 to 4, colours as red,
    green, blue instead of SH, ASCII, either byte order, `filter_3D` of Mip-Splatting, discs of
    2DGS, CloudCompare's names) and SuperSplat's compressed layout. A log scale of -inf becomes that
    of 1e-12. Splats with other non-finite numbers or a zero quaternion are dropped, and
    coefficients beyond degree 4 are cut, both with a logged warning.

    Args:
        path: The .ply file.

    Returns:
        Raw parameters in the file's world.

    Raises:
        DatasetError: the file is missing.
        FormatError: it is truncated or corrupt, no PLY, or a PLY without splats.
    """
    path = Path(path)
    elements = read_elements(path)
    if is_compressed(elements):
        raw = decompress(path, elements)
    else:
        raw = parameters_of(path, _vertices(elements))
    rest = rest_by_coefficient(path, raw.pop("rest"))
    return drawable(path, **raw, shN=rest)


def read_ply_parts(path: str | Path, rows: int) -> Iterator[Splats]:
    """Like `read_ply`, `rows` splats of the file at a time, for models larger than memory.

    Raises:
        As `read_ply`; FormatError also for the compressed layout.
    """
    path = Path(path)
    table = _vertices(read_elements(path))
    count, dropped = len(table), 0
    for at in range(0, count, rows):
        if isinstance(table.base, np.memmap):  # a mapping keeps the pages it has read
            table = _vertices(read_elements(path))
        raw = parameters_of(path, table[at : at + rows])
        rest = rest_by_coefficient(path, raw.pop("rest"))
        part = Splats(**raw | {"sh0": raw["sh0"][:, None]}, shN=rest)
        kept = drawable_rows(part)
        dropped += len(part) - len(kept)
        yield kept
    warn_dropped_rows(path, dropped, count)


def _vertices(elements: dict[str, np.ndarray]) -> np.ndarray:
    """The vertex element; without one, an empty table."""
    return elements.get("vertex", np.zeros(0, [("none", "f4")]))


def header_comments(path: str | Path) -> tuple[str, ...]:
    """Comment lines of a PLY's header, without the word comment.

    Raises:
        DatasetError: the file is missing.
    """
    path = Path(path)
    try:
        with open_regular(path) as file:
            header = HEADER_END.split(file.read(HEADER_LIMIT), maxsplit=1)[0]
    except (OSError, ValueError) as error:
        raise DatasetError(f"Cannot read {brief(path)}: {reason(error)}") from error
    lines = header.decode("utf-8", "replace").splitlines()
    return tuple(line[8:].strip() for line in lines if line.startswith("comment "))


def has_antialias_comment(comments: tuple[str, ...]) -> bool:
    """True if a header comment of gscore or Postshot states compensated opacities."""
    marks = (MIP_COMMENT.lower(), "antialiased 1", "antialiased: 1")
    return any(line.lower().startswith(marks) for line in comments)


def origin_comment(origin: np.ndarray) -> str:
    """Header comment that states a local origin [3] exactly."""
    return _ORIGIN + " ".join(map(repr, origin.astype(np.float64).tolist()))


def is_origin_comment(line: str) -> bool:
    """True if a header comment states a local origin."""
    return line.startswith(_ORIGIN)


def stated_origin(path: Path, comments: tuple[str, ...]) -> np.ndarray | None:
    """[3] float64, local origin from header comments; None if they state none.

    Raises:
        FormatError: an origin comment has no three numbers.
    """
    for line in filter(is_origin_comment, comments):
        try:
            return checked_origin([float(word) for word in line.removeprefix(_ORIGIN).split()])
        except ValueError as error:
            raise FormatError(
                f"{path}: its comment {quoted(line)} states no local origin; expected three "
                f"numbers. Remove the comment if the splats have no local origin."
            ) from error
    return None


def is_antialiased_ply(path: str | Path) -> bool:
    """True if the header of a PLY states that its splats need the anti-aliasing compensation.

    Raises:
        DatasetError: the file is missing.
    """
    return has_antialias_comment(header_comments(path))


def write_splats(path: str | Path, splats: Splats, *, comments: tuple[str, ...] = ()) -> None:
    """Write a model in the official layout, completely or not at all.

    Binary little endian float32: x y z nx ny nz f_dc_0..2 f_rest_* opacity scale_0..2 rot_0..3,
    with zero normals and f_rest channel-major (all red coefficients, then green, then blue).

    Args:
        path: The file to write; its folder is made.
        splats: The model, raw parameters.
        comments: Header comments, for example `MIP_COMMENT`. PLY is ASCII: other characters are
            written as Python's escapes, and each line of a text as its own comment.

    Raises:
        GsError: the file cannot be written.
        ConfigError: the comments are longer than readers accept.
    """
    write_splat_parts(
        path, [splats], count=len(splats), sh_degree=splats.sh_degree, comments=comments
    )


def write_splat_parts(
    path: str | Path,
    parts: Iterable[Splats],
    *,
    count: int,
    sh_degree: int,
    comments: tuple[str, ...] = (),
) -> None:
    """Like `write_splats`, for a model in parts with `count` splats of one SH degree in total."""
    rest = 3 * SH_REST_BY_DEGREE[sh_degree]
    names = [*POSITION, "nx", "ny", "nz", *DC, *(f"f_rest_{k}" for k in range(rest))]
    names += ["opacity", *SCALE, *QUAT]
    lines = [line for text in comments for line in text.splitlines()]
    lines = ["format binary_little_endian 1.0", *(f"comment {line}" for line in lines)]
    lines += [f"element vertex {count}", *(f"property float {name}" for name in names)]
    header = header_bytes(lines)

    def write(file: BinaryIO) -> None:
        file.write(header)
        for splats in parts:
            # Blocks limit memory and keep the transposition in cache.
            for at in range(0, len(splats), _ROWS_A_BLOCK):
                file.write(_table(splats, slice(at, at + _ROWS_A_BLOCK)).data)

    atomic_write(path, write)


def _table(splats: Splats, part: slice) -> np.ndarray:
    """[n, 17 + rest] rows of the official layout."""
    means = splats.means[part]
    rest = 3 * splats.shN.shape[1]
    rows = np.zeros((len(means), 17 + rest), "<f4")
    rows[:, 0:3] = means
    rows[:, 6:9] = splats.sh0[part, 0]
    by_channel = splats.shN[part].transpose(0, 2, 1)  # [n, 3, K-1]
    rows[:, 9 : 9 + rest] = by_channel.reshape(len(means), rest)
    rows[:, 9 + rest] = splats.opacities[part]
    rows[:, 10 + rest : 13 + rest] = splats.scales[part]
    rows[:, 13 + rest :] = splats.quats[part]
    return rows
