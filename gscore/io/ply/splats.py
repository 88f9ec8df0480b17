"""PLY splats: reader of every dialect, writer of the official 3DGS layout.

Sources of the dialects: `filter_3D` as the code of Mip-Splatting applies it (Yu et al. 2024,
section 4.1; also written by GOF and RaDe-GS); 2DGS (Huang et al. 2024), whose discs have two
scales; CloudCompare, which prefixes every property except positions and colours with `scalar_`.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ...errors import DatasetError, FormatError
from ...quoting import brief, quoted
from ...scene import checked_origin
from ...sh import rgb_to_sh0
from ...splats import SH_REST_BY_DEGREE, Splats
from ..files import atomic_write, open_regular, reason
from ..splat_rows import drawable, drawable_rows, logits, warn_dropped_rows, whole_bands
from .compressed import decompress, is_compressed
from .elements import HEADER_END, HEADER_LIMIT, columns, header_bytes, read_elements

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
