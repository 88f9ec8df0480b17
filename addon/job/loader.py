"""Reads splat files in a thread, so that Blender does not wait for a disk; no bpy."""

import threading
from collections import deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core import GsError, Splats, read_splats


@dataclass(frozen=True, kw_only=True)
class Loaded:
    """A file that was read, or why it was not."""

    path: Path
    splats: Splats | None
    problem: str = ""
    final: bool = False
    """Whether this is the result and not a snapshot."""


class Loader:
    """Reads one file after the other; of the snapshots that wait only the latest counts."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[Path, int, bool]] = deque(maxlen=1)
        self._ready: deque[Loaded] = deque(maxlen=1)
        self._lock = threading.Lock()
        self._busy = False

    @property
    def busy(self) -> bool:
        """Whether a file is being read or waits to be."""
        with self._lock:
            return self._busy

    def request(self, path: Path, *, most: int = 0, final: bool = False) -> None:
        """Read a splat file soon.

        Args:
            path: The PLY.
            most: Keep at most this many splats, evenly chosen, and without view-dependent colour:
                a quick look while training goes on; 0: everything.
            final: Handed back in `Loaded.final`.
        """
        with self._lock:
            self._waiting.append((path, most, final))
            if self._busy:
                return
            self._busy = True
        threading.Thread(target=self._work, name="gscore-loader", daemon=True).start()

    def take(self) -> Loaded | None:
        """The last file that was read since the last call."""
        with self._lock:
            return self._ready.popleft() if self._ready else None

    def _work(self) -> None:
        while True:
            with self._lock:
                if not self._waiting:
                    self._busy = False
                    return
                path, most, final = self._waiting.popleft()
            loaded = _load(path, most, final)
            with self._lock:
                self._ready.append(loaded)


def _load(path: Path, most: int, final: bool) -> Loaded:
    try:
        splats = read_splats(path)
    except GsError as error:
        return Loaded(path=path, splats=None, problem=str(error), final=final)
    except MemoryError:
        problem = f"{path} does not fit into memory; close other programs and import it again."
        return Loaded(path=path, splats=None, problem=problem, final=final)
    return Loaded(path=path, splats=_quick_look(splats, most) if most else splats, final=final)


def _quick_look(splats: Splats, most: int) -> Splats:
    """At most `most` splats, evenly chosen, of SH degree 0."""
    every = max(1, -(-len(splats) // most))
    return Splats(
        means=np.ascontiguousarray(splats.means[::every]),
        quats=np.ascontiguousarray(splats.quats[::every]),
        scales=np.ascontiguousarray(splats.scales[::every]),
        opacities=np.ascontiguousarray(splats.opacities[::every]),
        sh0=np.ascontiguousarray(splats.sh0[::every]),
        shN=np.zeros((len(splats.means[::every]), 0, 3), np.float32),
    )
