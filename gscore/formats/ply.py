"""PLY models: reader of every dialect, writer of the official 3DGS layout."""

from pathlib import Path

import numpy as np

from ..io.file_sample import FileSample
from ..io.ply.splats import (
    MIP_COMMENT,
    has_antialias_comment,
    header_comments,
    is_antialiased_ply,
    is_origin_comment,
    origin_comment,
    read_ply,
    read_ply_parts,
    stated_origin,
    write_splats,
)
from ..splats import Splats
from .splat_file import Decoded, SplatFormat, WriteOptions


def is_ply(path: Path, sample: FileSample) -> bool:
    """True if a file begins like a PLY, also after a byte order mark."""
    return sample.head.removeprefix(b"\xef\xbb\xbf").startswith((b"ply\n", b"ply\r"))


def read(path: Path) -> Decoded:
    """Read a PLY of any dialect, as `gscore.io.ply.splats.read_ply`, with its metadata."""
    splats, comments = read_ply(path), header_comments(path)
    return Decoded(
        splats=splats,
        layout="3DGS",
        antialiased=has_antialias_comment(comments),
        origin=stated_origin(path, comments),
        comments=comments,
    )


def comments_of(options: WriteOptions) -> tuple[str, ...]:
    """Header comments, with the mark of the antialias compensation and the local origin."""
    marks = (MIP_COMMENT,) if options.antialiased else ()
    marks += () if options.origin is None else (origin_comment(options.origin),)
    others = (line for line in options.comments if not has_antialias_comment((line,)))
    return (*marks, *(line for line in others if not is_origin_comment(line)))


def write(path: Path, splats: Splats, options: WriteOptions) -> list[str]:
    """Write the official layout."""
    write_splats(path, splats, comments=comments_of(options))
    return []


def origin_of_ply(path: Path) -> np.ndarray | None:
    """Local origin [3] in a file's header; None: none."""
    return stated_origin(path, header_comments(path))


PLY = SplatFormat(
    key="ply",
    name="3DGS PLY",
    endings=(".ply",),
    recognizes=is_ply,
    read=read,
    write=write,
    is_antialiased=is_antialiased_ply,
    file_origin=origin_of_ply,
    read_parts=read_ply_parts,
    most_degree=4,
)
