"""COLMAP's binary files: cameras.bin, images.bin, points3D.bin (little endian)."""

import logging
import struct
from pathlib import Path

import numpy as np

from ..errors import FormatError
from .camera_models import MODELS_BY_ID, MODELS_BY_NAME
from .colmap_model import ColmapCamera, ColmapImage, ColmapPoints
from .files import open_regular, read_bytes

_log = logging.getLogger(__name__)

_COUNT = struct.Struct("<Q")
_CAMERA = struct.Struct("<IiQQ")
_IMAGE = struct.Struct("<I7dI")
_OBSERVATION = np.dtype([("xy", "<f8", 2), ("id", "<i8")])
_POINT = np.dtype(
    [("id", "<i8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("track", "<u8")]
)
_TRACK = np.dtype([("image", "<u4"), ("index", "<u4")])


class _Reader:
    """Bytes of one file with a position; every access is checked against the end of the file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.data = read_bytes(path)
        self.at = 0

    def need(self, size: int, what: str) -> None:
        """Raise FormatError unless `size` more bytes are there; ask before allocating for them."""
        left = len(self.data) - self.at
        if size > left:
            raise FormatError(
                f"{self.path} is truncated or corrupt: {what} at byte {self.at} takes {size} "
                f"bytes, {left} are left. Copy the model again or export it anew from COLMAP."
            )

    def unpack(self, layout: struct.Struct, what: str) -> tuple:
        self.need(layout.size, what)
        values = layout.unpack_from(self.data, self.at)
        self.at += layout.size
        return values

    def count(self, smallest: int, what: str) -> int:
        """Read a number of records, each of at least `smallest` bytes."""
        (number,) = self.unpack(_COUNT, f"the number of {what}")
        self.need(number * smallest, f"a list of {number} {what}")
        return number

    def text(self, what: str) -> str:
        end = self.data.find(b"\0", self.at)
        if end < 0:
            self.need(len(self.data) + 1, f"{what} without an end")
        raw, self.at = self.data[self.at : end], end + 1
        try:
            return raw.decode("utf-8")
        except UnicodeDecodeError as error:
            raise FormatError(
                f"{self.path}: {what} before byte {end} is not UTF-8 text: {raw[:60]!r}. "
                f"Rename the photos to plain letters and run COLMAP again, or repair the file."
            ) from error

    def end(self) -> None:
        """Tell of bytes that belong to no record: a count that is too small loses the rest."""
        if left := len(self.data) - self.at:
            _log.warning(
                "%s: %d bytes after the last record it announces are not read; if the file was "
                "cut or joined, export the model anew from COLMAP.",
                self.path,
                left,
            )


def read_cameras(path: Path) -> dict[int, ColmapCamera]:
    """Cameras of a cameras.bin by id."""
    reader = _Reader(path)
    cameras = {}
    for _ in range(reader.count(_CAMERA.size, "cameras")):
        camera_id, model_id, width, height = reader.unpack(_CAMERA, "a camera")
        model = MODELS_BY_ID.get(model_id)
        if model is None:
            raise FormatError(
                f"{path}: camera {camera_id} has the unknown camera model id {model_id}, known are "
                f"0 to {max(MODELS_BY_ID)}. Undistort the capture with COLMAP, or update gscore."
            )
        params = reader.unpack(struct.Struct(f"<{len(model.params)}d"), f"a {model.name} camera")
        cameras[camera_id] = ColmapCamera(
            model=model.name, width=width, height=height, params=np.array(params)
        )
    reader.end()
    return cameras


def count_images(path: Path) -> int:
    """Number of images an images.bin says it holds, without reading on."""
    with open_regular(path) as file:
        head = file.read(_COUNT.size)
    return _COUNT.unpack(head)[0] if len(head) == _COUNT.size else 0


def read_images(path: Path) -> list[ColmapImage]:
    """Images of an images.bin in file order."""
    reader = _Reader(path)
    images = []
    for _ in range(reader.count(_IMAGE.size + 1 + _COUNT.size, "images")):
        values = reader.unpack(_IMAGE, "an image")
        name = reader.text("an image name")
        size = reader.count(_OBSERVATION.itemsize, f"observations of {name}")
        seen = np.frombuffer(reader.data, _OBSERVATION, size, reader.at)
        reader.at += seen.nbytes
        images.append(
            ColmapImage(
                id=values[0],
                name=name,
                camera_id=values[8],
                qvec=np.array(values[1:5]),
                tvec=np.array(values[5:8]),
                xys=seen["xy"].astype(np.float64),
                point3D_ids=seen["id"].astype(np.int64),
            )
        )
    reader.end()
    return images


def read_points(path: Path) -> ColmapPoints:
    """Points of a points3D.bin in file order."""
    reader = _Reader(path)
    number = reader.count(_POINT.itemsize, "points")
    # A record's place depends on the track before it, so lengths are walked one by one; everything
    # else is gathered at once.
    starts = np.zeros(number, np.int64)
    track_at, track_size = _POINT.itemsize - _COUNT.size, _TRACK.itemsize
    unpack = _COUNT.unpack_from
    at, last = reader.at, len(reader.data) - _POINT.itemsize
    for i in range(number):
        reader.at = at
        if at > last:
            reader.need(_POINT.itemsize, f"point {i} of {number}")
        starts[i] = at
        at += _POINT.itemsize + track_size * unpack(reader.data, at + track_at)[0]
    if number:
        reader.at = int(starts[-1])
        reader.need(at - reader.at, f"the track of point {number - 1} of {number}")
        reader.at = at
    reader.end()
    raw = np.frombuffer(reader.data, np.uint8)
    rows = raw[starts[:, None] + np.arange(_POINT.itemsize)]  # [P, 51]
    points = np.ascontiguousarray(rows).view(_POINT)[:, 0] if number else np.zeros(0, _POINT)
    return ColmapPoints(
        ids=points["id"].astype(np.int64),
        xyz=points["xyz"].astype(np.float64),
        rgb=points["rgb"].copy(),
        error=points["error"].astype(np.float64),
        track_lengths=points["track"].astype(np.int32),
    )


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
        seen = np.zeros(len(image.xys), _OBSERVATION)
        seen["xy"], seen["id"] = image.xys, image.point3D_ids
        out.append(_COUNT.pack(len(seen)))
        out.append(seen.tobytes())
    return b"".join(out)


def points_to_bytes(points: ColmapPoints, tracks: np.ndarray, lengths: np.ndarray) -> bytes:
    """Contents of a points3D.bin.

    Args:
        points: The points; their `track_lengths` are not used.
        tracks: [sum(lengths), 2] int, (image id, index of the observation), point after point.
        lengths: [P] int, observations a point.
    """
    records = np.zeros(len(points), _POINT)
    records["id"], records["xyz"], records["rgb"] = points.ids, points.xyz, points.rgb
    records["error"], records["track"] = points.error, lengths
    ends = np.cumsum(_POINT.itemsize + _TRACK.itemsize * lengths)
    out = np.zeros(int(ends[-1]) if len(ends) else 0, np.uint8)
    is_track = np.ones(len(out), bool)
    starts = ends - _TRACK.itemsize * lengths - _POINT.itemsize
    places = starts[:, None] + np.arange(_POINT.itemsize)
    out[places] = records.view(np.uint8).reshape(len(points), _POINT.itemsize)
    is_track[places] = False
    out[is_track] = np.frombuffer(np.ascontiguousarray(tracks).astype("<u4").tobytes(), np.uint8)
    return _COUNT.pack(len(points)) + out.tobytes()
