"""Splat file contents: a model and its metadata, results of readers and inputs of writers."""

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from ..errors import FormatError
from ..io.file_sample import FileSample
from ..io.mesh.files import TriangleMesh
from ..scene import are_relative_to, checked_origin, offset_between, origin_text
from ..sh import sh0_to_rgb
from ..splats import Splats
from ..text_format import count_text

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Decoded:
    """A decoded model with the metadata of its file."""

    splats: Splats
    """Raw parameters, in the axes of a 3DGS PLY: as COLMAP's, usually +Y down."""
    layout: str
    """Layout of the file within its format, for display."""
    antialiased: bool = False
    """True if the file marks its splats as trained with antialias compensation."""
    origin: np.ndarray | None = None
    """[3] float64, local origin of the means, as `Cameras.origin`; None: not stated."""
    comments: tuple[str, ...] = ()
    """Header comments."""

    def about(self, origin: np.ndarray | None) -> Self:
        """The same model with means relative to another local origin, [3]; computed in float64."""
        shift = offset_between(origin, self.origin)
        if not shift.any():
            return self
        means = (self.splats.means.astype(np.float64) - shift).astype(np.float32)
        return replace(self, splats=replace(self.splats, means=means), origin=origin)

    def of_capture(self, origin: np.ndarray | None) -> Self:
        """The model with its local origin, as splats of a capture with the local origin `origin`.

        Programs that edit splats lose the stated origin. If a file states none, `origin` is assumed
        if `are_relative_to` is true, with a logged warning.
        """
        if (
            self.origin is not None
            or origin is None
            or not are_relative_to(self.splats.means, origin)
        ):
            return self
        _log.warning(
            "The splats state no local origin, but are around that of the capture, %s; it is "
            "assumed for them.",
            origin_text(origin),
        )
        return replace(self, origin=origin)


@dataclass(frozen=True, kw_only=True)
class SplatFile(Decoded):
    """Result of reading a file."""

    path: Path
    """The file; for an unpacked SOG, its folder."""
    format: str
    """Key of the format in `FORMATS`."""
    storage_bytes: int
    """Bytes on the disk, of all files."""
    notes: tuple[str, ...]
    """Messages about contents of the file that the model lacks: dropped splats or coefficients."""


@dataclass(frozen=True, kw_only=True)
class WriteOptions:
    """Options of writers."""

    antialiased: bool
    """True if its splats need the anti-aliasing compensation."""
    comments: tuple[str, ...]
    """Comments, for formats that support them."""
    spz_version: int
    """Version of SPZ: 3 or 4."""
    origin: np.ndarray | None = None
    """[3] float64, local origin of the means; None: none."""
    proxy: TriangleMesh | None = None
    """Mesh to write with the splats, hidden; None: none."""

    @property
    def proxy_vertices(self) -> np.ndarray:
        """[V, 3] float64, the vertices of the proxy, from the local origin of the means."""
        assert self.proxy is not None
        return self.proxy.vertices + offset_between(None, self.origin)


@dataclass(frozen=True, kw_only=True)
class WrittenFile:
    """Result of writing a file."""

    path: Path
    """The path as given."""
    format: str
    """Key of the format in `FORMATS`."""
    storage_bytes: int
    """Bytes on the disk, of all files."""
    notes: tuple[str, ...]
    """Messages about contents of the model that the file lacks."""


ORIGIN = "origin"
"""Key of a local origin, [3], in formats with JSON metadata."""


def origin_in(facts: Mapping[str, Any], damaged: Callable[[str], FormatError]) -> np.ndarray | None:
    """[3] float64, local origin in the metadata of a file; None: none.

    Raises:
        FormatError: it is invalid; made by `damaged` from the reason.
    """
    if ORIGIN not in facts:
        return None
    try:
        return checked_origin(facts[ORIGIN])
    except ValueError as error:
        raise damaged(f"it misstates its {error}") from error


def colors_note(sh0: np.ndarray, low: float, high: float, name: str) -> str:
    """Note on colours outside the range of a format; empty without any.

    Args:
        sh0: [N, 1, 3] coefficients.
        low: Coefficient of byte 0.
        high: Coefficient of byte 255.
        name: Name of the format.
    """
    half = (high - low) / 510
    beyond = int(((sh0 < low - half) | (sh0 > high + half)).any(axis=(1, 2)).sum())
    if not beyond:
        return ""
    ends = " to ".join(
        f"{round(float(end), 3) + 0:.2g}" for end in sh0_to_rgb(np.array([low, high]))
    )
    return (
        f"Colours of {count_text(beyond, 'splat')} outside the range of {name}, {ends}, "
        f"became its nearest colours."
    )


@dataclass(frozen=True, kw_only=True)
class SplatFormat:
    """A format: detection, reader and writer."""

    key: str
    """Name in options and in JSON."""
    name: str
    """Name in messages."""
    endings: tuple[str, ...]
    """Endings of its files, the usual one first; the longest match among all formats decides."""
    recognizes: Callable[[Path, FileSample], bool]
    """Returns whether a file is of this format, by its first bytes."""
    read: Callable[[Path], Decoded]
    """Reads a file; raises GsError."""
    write: Callable[[Path, Splats, WriteOptions], list[str]] | None
    """Writes a file, returns the notes of `WrittenFile`; raises GsError; None: read only."""
    is_antialiased: Callable[[Path], bool] | None = None
    """Returns whether a file is marked as antialiased, without reading all of it; raises GsError;
    None: needs `read`."""
    file_origin: Callable[[Path], np.ndarray | None] | None = None
    """Returns the local origin of a file, without reading all of it; raises GsError; None: needs
    `read`."""
    read_parts: Callable[[Path, int], Iterator[Splats]] | None = None
    """Reads a given number of splats at a time; raises GsError; None: reads models whole."""
    part_files: Callable[[Path], Iterable[Path]] = lambda path: ()
    """Returns the part files of a file."""
    most_degree: int = 3
    """Highest SH degree that it can store."""
    keeps_antialiased: bool = True
    """True if it can mark splats as trained with antialias compensation."""
    keeps_origin: bool = True
    """True if it can store the local origin of the means."""
    keeps_proxy: bool = False
    """True if it can store a mesh with the splats."""
