"""Dataset: a capture ready for training, with scene, photos as bytes, masks and split."""

import hashlib
import os
import zlib
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from threading import Lock
from typing import TypeVar

import numpy as np

from ..config import checked_threads
from ..errors import BackendError, Cancelled, DatasetError
from ..io.files import open_regular
from ..io.images.read_image import decoding_pixels
from ..scene import Scene
from .decode import DECODED_AT_ONCE, ViewFile, decode_view

S = TypeVar("S")
T = TypeVar("T")

_FEW = 4
"""Views kept after `limit_cache`: photo and mask of a view are requested separately."""


class Dataset:
    """Photos and masks by view index, as in `scene.cameras`; each photo is decoded once and kept as
    bytes, or, after `limit_cache`, decoded when needed."""

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
        """Indices of the training views, ascending."""
        self.test = test
        """Indices of the held-out views, ascending; may be empty."""
        self.mask_mode = mask_mode
        """`composite`: the mask is opacity; `ignore`: pixels where it is 0 are ignored; `none`."""
        self.source = source
        """Folder of the capture."""
        self._files = files
        self._views: dict[int, tuple[np.ndarray, np.ndarray | None]] = {}
        self._unchanged = ChangeDetector(
            p for f in files for p in (f.image, f.mask) if p is not None
        )
        self._prints: dict[int, int] = {}
        """Checksums of decoded views, which may be decoded again."""
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
        """Files and decoding settings of each view, by index."""
        return tuple(self._files)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Messages for the user about data that was repaired or left out while reading."""
        return self.scene.warnings

    @property
    def nbytes(self) -> int:
        """Upper bound of the bytes of all decoded photos and masks, known before decoding."""
        return sum(file.nbytes for file in self._files)

    @property
    def decoding_pixels(self) -> int:
        """Number of pixels of all photos as stored; see `decoding_pixels` of their files."""
        return sum(decoding_pixels(file.image, file.photo_size) for file in self._files)

    def decoding_bytes(self, threads: int = 0) -> int:
        """Most bytes that `threads` threads (0: one per core) take while decoding photos, in
        addition to `nbytes`."""
        most = max((file.decoding_bytes for file in self._files), default=0)
        at_once = min(threads or os.cpu_count() or 1, DECODED_AT_ONCE // max(most, 1))
        return most * max(at_once, 1)

    def content_hash(self) -> str:
        """Short hash of all photos and masks, computed once; identifies a changed capture.

        Raises:
            DatasetError: a file is missing, cannot be read, or changed since the capture was read.
        """
        if self._content_hash is None:
            digest = hashlib.sha256()
            for file in self._files:
                for path in (file.image, file.mask):
                    digest.update(b"-" if path is None else self._unchanged.hash(path))
                if file.mask is not None and file.mask_inverted:
                    digest.update(b"inverted")
            self._content_hash = digest.hexdigest()[:16]
        return self._content_hash

    def image(self, index: int) -> np.ndarray:
        """[H, W, 3] uint8, contiguous; decoded on first use. Do not write to it.

        Raises:
            DatasetError: the file or its mask changed since the capture was read.
            FormatError: the file is corrupt.
            BackendError: there is too little memory for it.
        """
        return self._view(index)[0]

    def mask(self, index: int) -> np.ndarray | None:
        """[H, W] uint8, 255 = keep, or None for a view without mask. Do not write to it."""
        return self._view(index)[1]

    def limit_cache(self) -> None:
        """Keep only the last decoded views from now on, for captures larger than memory."""
        with self._lock:
            self._keep_all = False
            self._prints |= {i: _print(view) for i, view in self._views.items()}
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
            indices: Views to decode; None: all.
            threads: Number of threads; 0: one per core.
            on_progress: Called with (done, total) after each view, on the calling thread.
            cancelled: Called between views; True stops the call.

        Raises:
            FormatError: a file is corrupt.
            Cancelled: `cancelled` returned True.
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
            view = self._decoded(i)
            with self._lock:
                view = self._views.setdefault(i, view)
                while not self._keep_all and len(self._views) > _FEW:
                    del self._views[next(iter(self._views))]
        return view

    def _decoded(self, i: int) -> tuple[np.ndarray, np.ndarray | None]:
        """Decode a view from its files, which must be unchanged."""
        file = self._files[i]
        try:
            view = decode_view(file)
        except MemoryError as error:
            width, height = file.photo_size
            raise BackendError(
                f"Out of memory while {file.image}, {width} x {height} pixels, was decoded; use "
                f"smaller photos, or close programs."
            ) from error
        for path in (file.image, file.mask):
            if path is not None:
                self._unchanged.check(path)
        if not self._keep_all:
            # A changed file can have the same size and time, after `cp -p` or `rsync -t`.
            checksum = _print(view)
            if self._prints.setdefault(i, checksum) != checksum:
                raise changed_error(file.image)
        return view


def _print(view: tuple[np.ndarray, np.ndarray | None]) -> int:
    """Checksum of the pixels of a decoded view."""
    image, mask = view
    value = zlib.crc32(image.data)
    return value if mask is None else zlib.crc32(mask.data, value)


def map_threads(work: Callable[[S], T], items: list[S], *, threads: int = 0) -> Iterator[T]:
    """Results of `work` for all items, in order, computed in parallel with few results waiting.

    Args:
        work: Function of an item; parallel only where it releases the GIL, as decoding and numpy
            do.
        items: Arguments.
        threads: Number of threads; 0: one per core.
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


class ChangeDetector:
    """First size, time and, on request, hash of files, compared with later ones."""

    def __init__(self, paths: Iterable[Path]) -> None:
        """Record size and time of each file; missing files fail when they are read."""
        self._stamps = {path: _stamp(path) for path in paths}
        self._hashes: dict[Path, bytes] = {}

    def hash(self, path: Path) -> bytes:
        """SHA-256 of a file in its first state.

        Raises:
            DatasetError: it is missing, cannot be read, or changed before the call.
        """
        if path not in self._hashes:
            digest = _hash(path)
            if _stamp(path) != self._stamps[path]:
                raise changed_error(path)
            self._hashes[path] = digest
        return self._hashes[path]

    def check(self, path: Path) -> None:
        """Raise DatasetError if a file that was just read differs from its first state.

        Compares size and time; if they differ, the hash decides if it is known, because a file may
        have been copied back or touched.
        """
        stamp = _stamp(path)
        if stamp == self._stamps[path]:
            return
        if path not in self._hashes or _hash(path) != self._hashes[path]:
            raise changed_error(path)
        self._stamps[path] = stamp


def changed_error(path: Path) -> DatasetError:
    """Error for a file that changed since it was first read."""
    return DatasetError(
        f"{path} changed after the capture was read: it is another file now. Put the first one "
        f"back, or start again with the current photos."
    )


def _stamp(path: Path) -> tuple[int, int] | None:
    try:
        stat = path.stat()
    except OSError:
        return None
    return stat.st_size, stat.st_mtime_ns


def _hash(path: Path) -> bytes:
    try:
        with open_regular(path) as file:
            return hashlib.file_digest(file, "sha256").digest()
    except OSError as error:
        raise DatasetError(f"{path} cannot be read ({error.strerror}); restore it.") from error
