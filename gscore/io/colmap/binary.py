"""COLMAP binary files: cameras.bin, images.bin, points3D.bin (little endian)."""

import logging
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Self

import numpy as np

from ...errors import DatasetError, FormatError
from ...quoting import brief
from ..files import LONGEST_PATH, open_regular, reason
from .lenses import MODELS_BY_ID, MODELS_BY_NAME
from .model import ColmapCamera, ColmapImage, ColmapPoints

_log = logging.getLogger(__name__)

_COUNT = struct.Struct("<Q")
_CAMERA = struct.Struct("<IiQQ")
_IMAGE = struct.Struct("<I7dI")
_OBSERVATION = np.dtype([("xy", "<f8", 2), ("id", "<i8")])
_POINT = np.dtype(
    [("id", "<i8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("track", "<u8")]
)
_TRACK = np.dtype([("image", "<u4"), ("index", "<u4")])
_WINDOW, _WINDOW_OF_POINTS = 1 << 16, 1 << 22
"""Bytes of a file in memory at a time."""
_BATCH = 1 << 16
"""Points encoded at a time: saves half a gigabyte of memory and releases Python's lock often."""
_LONGEST_TEXT = LONGEST_PATH + 1
"""Bytes of a name with its zero byte."""


class _Reader:
    """File with a position; every access is checked against the file's end. Only a window of it is
    in memory, because points and observations of large models take gigabytes."""

    def __init__(self, path: Path, window: int = _WINDOW) -> None:
        self.path = path
        self.at = 0
        self._least = window
        self._window, self._start = b"", 0
        try:
            self._file = open_regular(path)
            self.size = os.fstat(self._file.fileno()).st_size
        except (OSError, ValueError) as error:
            raise DatasetError(f"Cannot read {brief(path)}: {reason(error)}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def need(self, size: int, what: str) -> None:
        """Raise FormatError unless `size` more bytes follow; call before allocating for them."""
        left = self.size - self.at
        if size > left:
            raise FormatError(
                f"{self.path} is truncated or corrupt: {what} at byte {self.at} takes {size} "
                f"bytes, {left} are left. Copy the model or export it from COLMAP again."
            )

    def window(self, size: int) -> memoryview:
        """Bytes from the position on: at least `size`, which must exist, usually more."""
        first = self.at - self._start
        if not 0 <= first <= len(self._window) - size:
            self._file.seek(self.at)
            self._window, self._start, first = self._file.read(max(size, self._least)), self.at, 0
        if len(self._window) - first < size:
            raise FormatError(f"{self.path} became shorter while it was read. Start again.")
        return memoryview(self._window)[first:]

    def take(self, size: int, what: str) -> memoryview:
        """The next bytes."""
        self.need(size, what)
        data = self.window(size)[:size]
        self.at += size
        return data

    def skip(self, size: int, what: str) -> None:
        """Skip bytes, which must exist."""
        self.need(size, what)
        self.at += size

    def unpack(self, layout: struct.Struct, what: str) -> tuple:
        """The next record."""
        return layout.unpack(self.take(layout.size, what))

    def count(self, smallest: int, what: str) -> int:
        """Read a record count; each record takes at least `smallest` bytes."""
        (number,) = self.unpack(_COUNT, f"the number of {what}")
        self.need(number * smallest, f"a list of {number} {what}")
        return number

    def text(self, what: str) -> str:
        """Text up to a zero byte."""
        most = min(self.size - self.at, _LONGEST_TEXT)
        raw, end, _ = bytes(self.window(most)[:most]).partition(b"\0")
        if not end and most < _LONGEST_TEXT:
            self.need(most + 1, f"{what} without an end")
        if not end:
            raise FormatError(
                f"{self.path} is corrupt: {what} at byte {self.at} is longer than {most} bytes. "
                f"Copy the model or export it from COLMAP again."
            )
        self.at += len(raw) + 1
        try:
            return raw.decode("utf-8")
        except UnicodeDecodeError as error:
            raise FormatError(
                f"{self.path}: {what} before byte {self.at - 1} is not UTF-8 text: {raw[:60]!r}. "
                f"Rename the photos to plain letters and run COLMAP again, or repair the file."
            ) from error

    def end(self) -> None:
        """Warn of bytes after the last record: a record count that is too small loses data."""
        if left := self.size - self.at:
            _log.warning(
                "%s: %d bytes after the last record it announces are not read; if the file was "
                "cut or joined, export the model from COLMAP again.",
                self.path,
                left,
            )


def read_cameras(path: Path) -> Iterator[tuple[int, ColmapCamera]]:
    """Cameras of a cameras.bin with their ids."""
    with _Reader(path) as reader:
        for _ in range(reader.count(_CAMERA.size, "cameras")):
            camera_id, model_id, width, height = reader.unpack(_CAMERA, "a camera")
            model = MODELS_BY_ID.get(model_id)
            if model is None:
                raise FormatError(
                    f"{path}: camera {camera_id} has the unknown camera model id {model_id}, known "
                    f"are 0 to {max(MODELS_BY_ID)}. Undistort the capture with COLMAP, or update "
                    f"gscore."
                )
            layout = struct.Struct(f"<{len(model.params)}d")
            params = reader.unpack(layout, f"a {model.name} camera")
            yield (
                camera_id,
                ColmapCamera(model=model.name, width=width, height=height, params=np.array(params)),
            )
        reader.end()


def count_images(path: Path) -> int:
    """Number of images stated at the start of an images.bin."""
    with open_regular(path) as file:
        head = file.read(_COUNT.size)
    return _COUNT.unpack(head)[0] if len(head) == _COUNT.size else 0


def read_images(path: Path, *, observations: bool = True) -> Iterator[ColmapImage]:
    """Images of an images.bin in file order; without `observations`, their `xys` are empty."""
    none = np.zeros(0, _OBSERVATION)
    with _Reader(path) as reader:
        for _ in range(reader.count(_IMAGE.size + 1 + _COUNT.size, "images")):
            values = reader.unpack(_IMAGE, "an image")
            name = reader.text("an image name")
            what = f"observations of {brief(name)}"
            nbytes = _OBSERVATION.itemsize * reader.count(_OBSERVATION.itemsize, what)
            if observations:
                observed = np.frombuffer(reader.take(nbytes, what), _OBSERVATION)
            else:
                observed = none
                reader.skip(nbytes, what)
            yield ColmapImage(
                id=values[0],
                name=name,
                camera_id=values[8],
                qvec=np.array(values[1:5]),
                tvec=np.array(values[5:8]),
                xys=observed["xy"].astype(np.float64),
                point3D_ids=observed["id"].astype(np.int64),
            )
        reader.end()


def read_points(path: Path) -> ColmapPoints:
    """Points of a points3D.bin in file order."""
    with _Reader(path, _WINDOW_OF_POINTS) as reader:
        number = reader.count(_POINT.itemsize, "points")
        points = ColmapPoints(
            ids=np.empty(number, np.int64),
            xyz=np.empty((number, 3), np.float64),
            rgb=np.empty((number, 3), np.uint8),
            error=np.empty(number, np.float64),
            track_lengths=np.empty(number, np.int32),
        )
        done = 0
        while done < number:
            reader.need(_POINT.itemsize, f"point {done} of {number}")
            records, last, end = _records(reader.window(_POINT.itemsize), number - done)
            begin, after = reader.at, done + len(records)
            reader.at = begin + last
            reader.need(end - last, f"the track of point {after - 1} of {number}")
            reader.at = begin + end
            part = slice(done, after)
            points.ids[part], points.xyz[part] = records["id"], records["xyz"]
            points.rgb[part], points.error[part] = records["rgb"], records["error"]
            points.track_lengths[part] = records["track"].astype(np.int32)
            done = after
        reader.end()
    return points


def _records(window: memoryview, most: int) -> tuple[np.ndarray, int, int]:
    """Points that begin in a window, without their tracks; the offset of the last point, and the
    offset of its track's end, which may be beyond the window.

    A record's offset depends on the track before it, so a loop walks the lengths; all other fields
    are copied in one gather.
    """
    starts: list[int] = []
    track_at, track_size = _POINT.itemsize - _COUNT.size, _TRACK.itemsize
    unpack, at, last = _COUNT.unpack_from, 0, len(window) - _POINT.itemsize
    while at <= last and len(starts) < most:
        starts.append(at)
        at += _POINT.itemsize + track_size * unpack(window, at + track_at)[0]
    raw = np.lib.stride_tricks.sliding_window_view(np.frombuffer(window, np.uint8), _POINT.itemsize)
    return np.ascontiguousarray(raw[starts]).view(_POINT)[:, 0], starts[-1], at


def cameras_to_bytes(cameras: dict[int, ColmapCamera]) -> bytes:
    """Contents of a cameras.bin."""
    out = [_COUNT.pack(len(cameras))]
    for camera_id, camera in cameras.items():
        model_id = MODELS_BY_NAME[camera.model].id
        out.append(_CAMERA.pack(camera_id, model_id, camera.width, camera.height))
        out.append(camera.params.astype("<f8").tobytes())
    return b"".join(out)


def images_to_bytes(images: list[ColmapImage]) -> bytes:
    """Contents of an images.bin."""
    out = [_COUNT.pack(len(images))]
    for image in images:
        out.append(_IMAGE.pack(image.id, *image.qvec, *image.tvec, image.camera_id))
        out.append(image.name.encode("utf-8") + b"\0")
        observed = np.zeros(len(image.xys), _OBSERVATION)
        observed["xy"], observed["id"] = image.xys, image.point3D_ids
        out.append(_COUNT.pack(len(observed)))
        out.append(observed.tobytes())
    return b"".join(out)


def points_to_bytes(points: ColmapPoints, tracks: np.ndarray, lengths: np.ndarray) -> bytes:
    """Contents of a points3D.bin.

    Args:
        points: The points; their `track_lengths` are not used.
        tracks: [sum(lengths), 2] int, (image id, index of the observation), ordered by point.
        lengths: [P] int, observations per point.
    """
    records = np.zeros(len(points), _POINT)
    records["id"], records["xyz"], records["rgb"] = points.ids, points.xyz, points.rgb
    records["error"], records["track"] = points.error, lengths
    ends = np.concatenate([[0], np.cumsum(lengths)])
    parts = [_COUNT.pack(len(points))]
    for begin in range(0, len(points), _BATCH):
        end = min(begin + _BATCH, len(points))
        own = tracks[ends[begin] : ends[end]]
        parts.append(_points_to_bytes(records[begin:end], own, lengths[begin:end]))
    return b"".join(parts)


def _points_to_bytes(records: np.ndarray, tracks: np.ndarray, lengths: np.ndarray) -> bytes:
    """A batch of points, each followed by its track."""
    ends = np.cumsum(_POINT.itemsize + _TRACK.itemsize * lengths)
    out = np.zeros(int(ends[-1]), np.uint8)
    is_track = np.ones(len(out), bool)
    starts = ends - _TRACK.itemsize * lengths - _POINT.itemsize
    places = starts[:, None] + np.arange(_POINT.itemsize)
    out[places] = records.view(np.uint8).reshape(len(records), _POINT.itemsize)
    is_track[places] = False
    out[is_track] = np.frombuffer(np.ascontiguousarray(tracks).astype("<u4").tobytes(), np.uint8)
    return out.tobytes()
