"""A capture ready to train on: scene, photos as bytes, masks and the split."""

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from threading import Lock
from typing import TypeVar

import numpy as np

from ..config import checked_threads
from ..errors import Cancelled, DatasetError
from ..io.files import open_regular
from ..scene import Scene
from .decode import ViewFile, decode_view

T = TypeVar("T")


_FEW = 4
"""Views kept after `keep_few`: photo and mask are asked for one after the other."""


class Dataset:
    """Views by index, as in `scene.cameras`; each photo is decoded once and kept as bytes, or,
    after `keep_few`, decoded whenever it is needed."""

    def __init__(
        self,
        *,
        scene: Scene,
        files: list[ViewFile],
        train: list[int],
        test: list[int],
        mask_mode: str,
        source: Path,
    ) -> None:
        self.scene = scene
        """Undistorted pinhole cameras at training resolution, sorted by name, and points."""
        self.train = train
        """Indices of the training views, rising."""
        self.test = test
        """Indices of the held-out views, rising; may be empty."""
        self.mask_mode = mask_mode
        """`composite`: the mask is opacity; `ignore`: pixels where it is 0 do not count; `none`."""
        self.source = source
        """Folder of the capture."""
        self._files = files
        self._views: dict[int, tuple[np.ndarray, np.ndarray | None]] = {}
        self._content_hash: str | None = None
        self._keep_all = True
        self._lock = Lock()

    def __len__(self) -> int:
        return len(self._files)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the views."""
        return self.scene.cameras.names

    @property
    def files(self) -> tuple[ViewFile, ...]:
        """How each view is decoded, by index."""
        return tuple(self._files)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences for the user about what was mended or left out while reading."""
        return self.scene.warnings

    @property
    def nbytes(self) -> int:
        """Bytes that all photos and masks take once decoded; known before, an upper bound."""
        return sum(file.nbytes for file in self._files)

    def content_hash(self) -> str:
        """Short hash of all photos and masks, read once; tells whether a capture changed.

        Raises:
            DatasetError: a file is missing or cannot be read.
        """
        if self._content_hash is None:
            digest = hashlib.sha256()
            for file in self._files:
                for path in (file.image, file.mask):
                    digest.update(b"-" if path is None else _file_hash(path))
                if file.mask is not None and file.mask_inverted:
                    digest.update(b"inverted")
            self._content_hash = digest.hexdigest()[:16]
        return self._content_hash

    def image(self, index: int) -> np.ndarray:
        """[H, W, 3] uint8, contiguous; decoded on first use. Do not write to it.

        Raises:
            FormatError: the file is corrupt.
        """
        return self._view(index)[0]

    def mask(self, index: int) -> np.ndarray | None:
        """[H, W] uint8, 255 = keep, or None for a view without mask. Do not write to it."""
        return self._view(index)[1]

    def keep_few(self) -> None:
        """From now on keep only the views decoded last, for captures larger than memory."""
        with self._lock:
            self._keep_all = False
            self._views.clear()

    def preload(
        self,
        indices: Iterable[int] | None = None,
        *,
        threads: int = 0,
        on_progress: Callable[[int, int], None] | None = None,
        cancelled: Callable[[], bool] | None = None,
    ) -> None:
        """Decode views in parallel.

        Args:
            indices: Which; None: all.
            threads: How many to use; 0: one a core.
            on_progress: Called with (done, total) after each view, on the calling thread.
            cancelled: Asked between views; true ends the call.

        Raises:
            FormatError: a file is corrupt.
            Cancelled: `cancelled` said so.
        """
        todo = list(range(len(self)) if indices is None else indices)
        for done, _ in enumerate(map_threads(self._view, todo, threads=threads), start=1):
            if on_progress is not None:
                on_progress(done, len(todo))
            if cancelled is not None and cancelled():
                raise Cancelled("Reading the photos was stopped.")

    def _view(self, i: int) -> tuple[np.ndarray, np.ndarray | None]:
        # Two threads may decode the same view at the same time; both get the same bytes.
        view = self._views.get(i)
        if view is None:
            view = decode_view(self._files[i])
            with self._lock:
                view = self._views.setdefault(i, view)
                while not self._keep_all and len(self._views) > _FEW:
                    del self._views[next(iter(self._views))]
        return view


def _file_hash(path: Path) -> bytes:
    try:
        with open_regular(path) as file:
            return hashlib.file_digest(file, "sha256").digest()
    except OSError as error:
        raise DatasetError(f"{path} cannot be read ({error.strerror}); restore it.") from error


def map_threads(work: Callable[[int], T], items: list[int], *, threads: int = 0) -> Iterator[T]:
    """Results of `work` for all items, in order, computed in parallel with few of them waiting.

    Args:
        work: Must release the interpreter lock to gain anything; decoding and numpy do.
        items: Arguments.
        threads: How many to use; 0: one a core.
    """
    threads = min(checked_threads(threads) or os.cpu_count() or 1, len(items))
    if threads <= 1:
        yield from map(work, items)
        return
    with ThreadPoolExecutor(threads) as pool:
        waiting: list[Future[T]] = []
        try:
            for item in items:
                waiting.append(pool.submit(work, item))
                if len(waiting) > 2 * threads:
                    yield waiting.pop(0).result()
            while waiting:
                yield waiting.pop(0).result()
        finally:
            for future in waiting:
                future.cancel()
