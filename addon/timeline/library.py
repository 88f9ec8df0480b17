"""Frame library: frames of sequences in memory, read ahead by a thread; no bpy."""

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..attributes import NO_SPLATS, columns
from ..core import GsError, Splats, read_splat_file
from ..interface.option_labels import error_text
from ..process.background_task import start_thread
from ..splats.filters import Filters, mask
from .frames import FrameFile, Series, find_series

MAX_AGE = 3.0
"""Interval of folder scans while its frames are shown, seconds."""
_GB = 1 << 30
_KEPT_PROBLEMS = 1000
_PATIENCE = 60.0
"""Timeout for a frame that another thread reads, before it is read again, seconds."""

AnswerT = TypeVar("AnswerT")
Folder = tuple[Path, str]
"""A folder, and the name pattern of its frames."""


@dataclass(frozen=True, eq=False)
class Frame:
    """The splats of a file, with the interface that renderers expect of a mesh copy."""

    file: FrameFile
    splats: Splats
    """Splats in the file's own world."""

    @property
    def fingerprint(self) -> Hashable:
        """Key that differs for different splats."""
        return self.file

    @property
    def vertices(self) -> range:
        """One vertex per splat."""
        return range(len(self.splats))

    @property
    def marks(self) -> None:
        """Always None: only meshes store selection and hiding."""

    @property
    def bytes(self) -> int:
        """Size in memory, bytes."""
        return sum(np.asarray(values).nbytes for values in vars(self.splats).values())

    def read(self) -> Splats:
        """The splats."""
        return self.splats

    def kept(self, filters: Filters) -> np.ndarray:
        """Splats that pass the filters, [N] bool."""
        splats = self.splats
        opacities = 1 / (1 + np.exp(-np.clip(splats.opacities.astype(np.float64), -500, 500)))
        return mask(splats.means, np.exp(splats.scales), opacities.astype(np.float32), filters)

    def columns(self) -> list[tuple[str, str, np.ndarray]]:
        """Like `attributes.columns`, for a mesh."""
        return columns(self.splats)


NOTHING = Frame(FrameFile(0, Path(), (0, 0)), NO_SPLATS)
"""Shown before and after a sequence that hides there."""


@dataclass
class _Known:
    """Result of a folder scan, or its error."""

    answer: Series | None = None
    problem: str = ""
    since: float = field(default_factory=time.monotonic)

    @property
    def old(self) -> bool:
        return time.monotonic() - self.since > MAX_AGE


class Library:
    """All frames of this Blender session. Thread-safe."""

    def __init__(
        self,
        read: Callable[[Path], Splats] = lambda path: read_splat_file(path).splats,
        find: Callable[[Path, str], Series] = find_series,
    ) -> None:
        """Prepare; the thread starts with the first request.

        Args:
            read: Reads a file.
            find: Lists a folder.
        """
        self._read, self._find = read, find
        self._changed = threading.Condition()
        self._series: dict[Folder, _Known] = {}
        self._folders_to_scan: OrderedDict[Folder, None] = OrderedDict()
        self._frames: OrderedDict[FrameFile, Frame] = OrderedDict()
        self._problems: OrderedDict[FrameFile, str] = OrderedDict()
        self._requests: dict[Hashable, tuple[FrameFile, ...]] = {}
        """The current frame, then the next ones, by requesting object."""
        self._under_way: FrameFile | None = None
        self._typical = 0
        self._era = 0
        """Number of calls of `clear`."""
        self._thread: threading.Thread | None = None
        self._closed = False
        self.most = _GB
        """Memory limit of frames, bytes; the current frames are kept in any case."""
        self.fresh = False
        """True if something was loaded since the last `take_change`."""
        self.reads = 0
        """Number of files read, for measurements."""

    def take_change(self) -> bool:
        """True if something was loaded since the last call."""
        with self._changed:
            came, self.fresh = self.fresh, False
        return came

    @property
    def busy(self) -> bool:
        """True while files or folders wait to be read."""
        with self._changed:
            return (
                self._under_way is not None
                or bool(self._folders_to_scan)
                or self._next() is not None
            )

    @property
    def loaded(self) -> tuple[int, int]:
        """Number of frames in memory, and their bytes."""
        with self._changed:
            return len(self._frames), sum(frame.bytes for frame in self._frames.values())

    def series(self, folder: Folder, *, wait: bool = False) -> tuple[Series | None, str]:
        """The frames of a folder: (series, ""), (None, error), or (None, "") while it is scanned.

        Args:
            folder: Absolute folder, and the name pattern of its frames.
            wait: Scan in this thread if the last result is older than `MAX_AGE`.
        """
        with self._changed:
            known = self._series.get(folder)
            if known is None or known.old:
                if wait:
                    self._folders_to_scan.pop(folder, None)
                else:
                    self._folders_to_scan[folder] = None
                    self._wake()
            else:
                wait = False
        if wait:
            known = self._look(folder)
        return (None, "") if known is None else (known.answer, known.problem)

    def frame(self, file: FrameFile, *, wait: bool = False) -> tuple[Frame | None, str]:
        """A frame: (frame, ""), (None, error), or (None, "") if it is not read yet.

        Args:
            file: File of a series.
            wait: Read it in this thread.
        """
        with self._changed:
            if wait and self._under_way == file:
                self._changed.wait_for(lambda: self._under_way != file, _PATIENCE)
            if file in self._frames:
                self._frames.move_to_end(file)
                return self._frames[file], ""
            problem = self._problems.get(file, "")
        if problem or not wait:
            return None, problem
        return self._load(file)

    def request(self, owner: Hashable, files: Sequence[FrameFile]) -> None:
        """Request files in this order, as far as memory permits, instead of the owner's earlier
        request.

        Args:
            owner: Any key of the requesting object.
            files: The current frame, then the next ones.
        """
        with self._changed:
            self._requests[owner] = tuple(files)
            if self._next() is not None:
                self._wake()

    def forget(self, folder: Folder) -> None:
        """Scan a folder again at its next request, and read its unreadable files again."""
        with self._changed:
            self._series.pop(folder, None)
            for file in [f for f in self._problems if folder[0] in f.path.parents]:
                del self._problems[file]

    def clear(self) -> None:
        """Drop all frames and requests; a file being read is dropped when it is loaded."""
        with self._changed:
            self._era += 1
            for kept in (
                self._series,
                self._folders_to_scan,
                self._frames,
                self._problems,
                self._requests,
            ):
                kept.clear()

    def close(self) -> None:
        """End the thread after its current file; the next request starts a new one."""
        self.clear()
        with self._changed:
            self._closed, self._thread = True, None
            self._changed.notify_all()

    def _wake(self) -> None:
        if self._thread is None:
            self._closed = False
            self._thread = start_thread(self._run, "gscore-frames", cancel=self.close)
        self._changed.notify_all()

    def _run(self) -> None:
        own = threading.current_thread()
        while True:
            with self._changed:
                while self._thread is own and not self._folders_to_scan and self._next() is None:
                    self._changed.wait()
                if self._thread is not own:
                    return
                folder = next(iter(self._folders_to_scan), None)
                file = None if folder is not None else self._next()
                self._under_way = file
            if folder is not None:
                self._look(folder)
            elif file is not None:
                self._load(file)
            with self._changed:
                if folder is not None:
                    self._folders_to_scan.pop(folder, None)
                self._under_way, self.fresh = None, True
                self._changed.notify_all()

    def _next(self) -> FrameFile | None:
        """Next file to read: current frames, then the next ones, soonest first."""
        for file in self._in_order():
            if file not in self._frames and file not in self._problems:
                return file
        return None

    def _in_order(self) -> list[FrameFile]:
        """Requested files that fit into memory, by urgency."""
        queues = list(self._requests.values())
        chosen: dict[FrameFile, None] = {}
        taken = 0
        for place in range(max(map(len, queues), default=0)):
            for queue in queues:
                file = queue[place] if place < len(queue) else None
                if file is None or file in chosen:
                    continue
                known = self._frames.get(file)
                taken += self._typical if known is None else known.bytes
                if place and taken > self.most:
                    return list(chosen)
                chosen[file] = None
        return list(chosen)

    def _load(self, file: FrameFile) -> tuple[Frame | None, str]:
        era = self._era
        answer, problem = _tried(lambda: Frame(file, self._read(file.path)), str(file.path))
        with self._changed:
            self.reads += 1
            if era != self._era:
                return answer, problem
            if answer is None:
                self._problems[file] = problem
                while len(self._problems) > _KEPT_PROBLEMS:
                    self._problems.popitem(last=False)
                return None, problem
            self._typical = answer.bytes
            self._frames[file] = answer
            self._make_room(file)
        return answer, ""

    def _make_room(self, new: FrameFile) -> None:
        """Evict frames without requests, least recently used first."""
        wanted = {new, *self._in_order()}
        total = sum(frame.bytes for frame in self._frames.values())
        for file in [f for f in self._frames if f not in wanted]:
            if total <= self.most:
                return
            total -= self._frames.pop(file).bytes

    def _look(self, folder: Folder) -> _Known:
        era = self._era
        series, problem = _tried(lambda: self._find(*folder), str(folder[0]))
        known = _Known(series, problem)
        with self._changed:
            if era == self._era:
                self._series[folder] = known
        return known


def _tried(act: Callable[[], AnswerT], what: str) -> tuple[AnswerT | None, str]:
    """Result of `act`, or an error sentence."""
    try:
        return act(), ""
    except MemoryError:
        return None, f"{what} does not fit into memory: close programs, or reduce the frame memory."
    except (GsError, ValueError, OSError) as error:
        return None, error_text(error) or f"{what} cannot be read ({type(error).__name__})."


LIBRARY = Library()
"""Library of this Blender session."""
