"""Splat file contents: a model and its metadata, as readers return them and writers take them."""

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from ..errors import FormatError
from ..io.file_sample import FileSample
from ..scene import checked_origin, lie_about, offset_between, origin_words
from ..sh import sh0_to_rgb
from ..splats import Splats
from ..text_format import count_words

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Decoded:
    """A model as the reader of one format found it."""

    splats: Splats
    """Raw parameters, in the axes of a 3DGS PLY: as COLMAP's, usually +Y down."""
    layout: str
    """Which of the layouts of its format the file has, for people."""
    antialiased: bool = False
    """Whether the file marks its splats as trained with antialias compensation."""
    origin: np.ndarray | None = None
    """[3] float64, the local origin that means are about, as `Cameras.origin`, where the file
    states one."""
    comments: tuple[str, ...] = ()
    """Further header lines."""

    def about(self, origin: np.ndarray | None) -> Self:
        """The same model with means about another local origin, [3]; computed in float64."""
        shift = offset_between(origin, self.origin)
        if not shift.any():
            return self
        means = (self.splats.means.astype(np.float64) - shift).astype(np.float32)
        return replace(self, splats=replace(self.splats, means=means), origin=origin)

    def of_capture(self, origin: np.ndarray | None) -> Self:
        """The model with its local origin made out, as splats of a capture that is about `origin`.

        Programs that edit splats lose what a file states. Those of a file that states nothing are
        about `origin` where `lie_about` says so; a warning is logged.
        """
        if self.origin is not None or origin is None or not lie_about(self.splats.means, origin):
            return self
        _log.warning(
            "The splats state no local origin, but lie about that of the capture, %s; it is taken "
            "for theirs.",
            origin_words(origin),
        )
        return replace(self, origin=origin)


@dataclass(frozen=True, kw_only=True)
class SplatFile(Decoded):
    """A file that was read."""

    path: Path
    """The file; of an unpacked SOG, its folder."""
    format: str
    """A key of `FORMATS`."""
    storage_bytes: int
    """Bytes on the disk, of all files."""
    notes: tuple[str, ...]
    """Sentences on contents of the file that the model lacks: splats or coefficients left out."""


@dataclass(frozen=True, kw_only=True)
class WriteOptions:
    """How a model is written."""

    antialiased: bool
    """Whether its splats want the anti-aliasing compensation."""
    comments: tuple[str, ...]
    """For headers that have room for them."""
    spz_version: int
    """Of SPZ: 3 or 4."""
    origin: np.ndarray | None = None
    """[3] float64, the local origin that means are about; None: there is none."""


@dataclass(frozen=True, kw_only=True)
class WrittenFile:
    """A file that was written."""

    path: Path
    """As it was given."""
    format: str
    """A key of `FORMATS`."""
    storage_bytes: int
    """Bytes on the disk, of all files."""
    notes: tuple[str, ...]
    """Sentences on contents of the model that the file lacks."""


ORIGIN = "origin"
"""Key of a local origin, [3], in formats whose JSON has room for it."""


def origin_in(facts: Mapping[str, Any], damaged: Callable[[str], FormatError]) -> np.ndarray | None:
    """[3] float64, the local origin among what a file says; None: none.

    Raises:
        FormatError: what `damaged` makes of a sentence without a subject, where it is no place.
    """
    if ORIGIN not in facts:
        return None
    try:
        return checked_origin(facts[ORIGIN])
    except ValueError as error:
        raise damaged(f"it misstates its {error}") from error


def colors_note(sh0: np.ndarray, low: float, high: float, name: str) -> str:
    """A sentence on colours that a format has no byte for; empty where there are none.

    Args:
        sh0: [N, 1, 3] coefficients.
        low: What byte 0 stands for.
        high: What byte 255 stands for.
        name: Of the format.
    """
    half = (high - low) / 510
    beyond = int(((sh0 < low - half) | (sh0 > high + half)).any(axis=(1, 2)).sum())
    if not beyond:
        return ""
    ends = " to ".join(
        f"{round(float(end), 3) + 0:.2g}" for end in sh0_to_rgb(np.array([low, high]))
    )
    return (
        f"Colours darker or brighter than {name} holds, {ends}, were cut to that: of "
        f"{count_words(beyond, 'splat')}."
    )


@dataclass(frozen=True, kw_only=True)
class SplatFormat:
    """A format: how its files are known, read and written."""

    key: str
    """Its name in options and in JSON."""
    name: str
    """Its name in sentences."""
    endings: tuple[str, ...]
    """Of the names of its files, the usual one first; the longest that fits decides."""
    holds: Callable[[Path, FileSample], bool]
    """Whether a file is of this format, by its first bytes."""
    read: Callable[[Path], Decoded]
    """Raises GsError."""
    write: Callable[[Path, Splats, WriteOptions], list[str]] | None
    """Returns the notes of `WrittenFile`; raises GsError; None: it is read only."""
    says_antialiased: Callable[[Path], bool] | None = None
    """Whether a file says that its splats want the compensation, where that takes no reading of all
    of it; raises GsError."""
    says_origin: Callable[[Path], np.ndarray | None] | None = None
    """The local origin that a file states, where that takes no reading of all of it; raises
    GsError."""
    read_parts: Callable[[Path, int], Iterator[Splats]] | None = None
    """Reads so many splats at a time; raises GsError; None: a model is read whole."""
    beside: Callable[[Path], Iterable[Path]] = lambda path: ()
    """Files that belong to one besides."""
    most_degree: int = 3
    """The highest SH degree that it holds."""
    keeps_antialiased: bool = True
    """Whether it can mark splats as trained with antialias compensation."""
    keeps_origin: bool = True
    """Whether it can state the local origin that means are about."""
