"""COLMAP text files: cameras.txt, images.txt, points3D.txt."""

import itertools
import logging
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ...errors import DatasetError, FormatError
from ...quoting import brief, quoted
from ..files import open_regular, reason
from .lenses import MODELS_BY_NAME
from .model import ColmapCamera, ColmapImage, ColmapPoints

_log = logging.getLogger(__name__)

_STATED = re.compile(r"#\s*Number of (\w+):\s*(\d{1,15})\b")
"""COLMAP's comment above the records."""
_BATCH = 1 << 15
"""Points parsed at a time: as Python numbers they take ten times the memory."""
_MARK = b"\xef\xbb\xbf"


class _Lines:
    """Iterator over the lines of one file, with the record count stated in its comments."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._stated: tuple[str, int] | None = None

    def __iter__(self) -> Iterator[tuple[int, str]]:
        """Each line with its number, from 0."""
        try:
            with open_regular(self.path) as file:
                at = len(_MARK) if file.read(len(_MARK)) == _MARK else 0
                file.seek(at)
                for number, raw in enumerate(file):
                    yield number, self._decoded(raw, at)
                    at += len(raw)
        except OSError as error:
            raise DatasetError(f"Cannot read {brief(self.path)}: {reason(error)}") from error

    def records(self) -> Iterator[tuple[int, str]]:
        """Lines with their numbers, without comments and empty lines."""
        for number, line in self:
            if not self.is_void(line):
                yield number, line

    def is_void(self, line: str) -> bool:
        """True if a line is not a record; a record count that it states is kept."""
        text = line.lstrip()
        if text.startswith("#") and self._stated is None and (found := _STATED.match(text)):
            self._stated = found[1], int(found[2])
        return not text or text.startswith("#")

    def check(self, count: int) -> None:
        """Warn if the number of records differs from the stated one."""
        if self._stated is not None and self._stated[1] != count:
            what, stated = self._stated
            _log.warning(
                "%s states %d %s and has %d; if it was cut or joined, export the model from COLMAP "
                "again.",
                self.path,
                stated,
                what,
                count,
            )

    def bad(self, number: int, expected: str) -> FormatError:
        """Error for a line that is not as expected."""
        return FormatError(
            f"{self.path} line {number + 1} is truncated or corrupt: expected {expected}. "
            f"Copy the model or export it from COLMAP again."
        )

    def _decoded(self, raw: bytes, at: int) -> str:
        try:
            return raw.decode("utf-8")
        except UnicodeDecodeError as error:
            raise FormatError(
                f"{self.path} is not UTF-8 text (byte {at + error.start}). Export the model from "
                f"COLMAP again."
            ) from error


def read_cameras(path: Path) -> Iterator[tuple[int, ColmapCamera]]:
    """Cameras of a cameras.txt with their ids."""
    lines, count = _Lines(path), 0
    expected = "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]"
    for at, line in lines.records():
        words = line.split()
        model = MODELS_BY_NAME.get(words[1]) if len(words) > 1 else None
        if len(words) > 1 and model is None:
            raise FormatError(
                f"{path} line {at + 1}: camera {brief(words[0])} has the unknown camera model "
                f"{quoted(words[1])}, known are {', '.join(MODELS_BY_NAME)}. Undistort the capture "
                f"with COLMAP, or update gscore."
            )
        if model is None or len(words) != 4 + len(model.params):
            raise lines.bad(at, expected)
        try:
            camera_id = int(words[0])
            camera = ColmapCamera(
                model=model.name,
                width=int(words[2]),
                height=int(words[3]),
                params=np.array([float(word) for word in words[4:]]),
            )
        except ValueError as error:
            raise lines.bad(at, expected) from error
        yield camera_id, camera
        count += 1
    lines.check(count)


def count_images(path: Path) -> int:
    """Number of images in an images.txt."""
    return sum(1 for _ in read_images(path, observations=False))


def read_images(path: Path, *, observations: bool = True) -> Iterator[ColmapImage]:
    """Images of an images.txt in file order: two lines each, the second may be empty. Without
    `observations`, their `xys` are empty."""
    lines, count = _Lines(path), 0
    numbered = iter(lines)
    expected = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
    for at, line in numbered:
        if lines.is_void(line):
            continue
        words = line.split(maxsplit=9)
        if len(words) < 10:
            raise lines.bad(at, expected)
        try:
            pose = np.array([float(word) for word in words[1:8]])
            image_id, camera_id = int(words[0]), int(words[8])
        except ValueError as error:
            raise lines.bad(at, expected) from error
        _, triples = next(numbered, (at + 1, ""))
        try:
            xys, ids = _observations(triples, observations)
        except (ValueError, OverflowError) as error:
            raise lines.bad(at + 1, "triples of X Y POINT3D_ID") from error
        yield ColmapImage(
            id=image_id,
            name=words[9].rstrip(),
            camera_id=camera_id,
            qvec=pose[:4],
            tvec=pose[4:],
            xys=xys,
            point3D_ids=ids,
        )
        count += 1
    lines.check(count)


def _observations(line: str, parse: bool) -> tuple[np.ndarray, np.ndarray]:
    """Positions [M, 2] and ids [M] of triples; ValueError or OverflowError if they are none."""
    words = line.split()
    if len(words) % 3:
        raise ValueError
    words = words if parse else []
    xys = np.array([words[0::3], words[1::3]], dtype=np.str_).astype(np.float64)
    return np.ascontiguousarray(xys.T), np.array(words[2::3], dtype=np.str_).astype(np.int64)


def read_points(path: Path) -> ColmapPoints:
    """Points of a points3D.txt in file order."""
    lines = _Lines(path)
    records, parts = lines.records(), [ColmapPoints.none()]
    while rows := list(itertools.islice(records, _BATCH)):
        parts.append(_points(lines, rows))
    names = ("ids", "xyz", "rgb", "error", "track_lengths")
    points = ColmapPoints(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    )
    lines.check(len(points))
    return points


def _points(lines: _Lines, rows: list[tuple[int, str]]) -> ColmapPoints:
    """Points of a batch of lines."""
    ids, numbers, colors, lengths = [], [], [], []
    for at, line in rows:
        words = line.split(maxsplit=8)
        track = words[8].split() if len(words) > 8 else []
        try:
            if len(words) < 8 or len(track) % 2:
                raise ValueError
            ids.append(int(words[0]))
            numbers.append([float(words[k]) for k in (1, 2, 3, 7)])
            colors.append([int(word) for word in words[4:7]])
            if not -(2**63) <= ids[-1] < 2**63 or not all(0 <= c <= 255 for c in colors[-1]):
                raise ValueError
        except ValueError as error:
            expected = "POINT3D_ID X Y Z R G B ERROR and pairs of IMAGE_ID POINT2D_IDX"
            raise lines.bad(at, expected) from error
        lengths.append(len(track) // 2)
    table = np.array(numbers, np.float64)
    return ColmapPoints(
        ids=np.array(ids, np.int64),
        xyz=np.ascontiguousarray(table[:, :3]),
        rgb=np.array(colors, np.uint8),
        error=table[:, 3].copy(),
        track_lengths=np.array(lengths, np.int32),
    )


def cameras_to_text(cameras: dict[int, ColmapCamera]) -> str:
    """Contents of a cameras.txt."""
    out = ["# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]"]
    for camera_id, camera in cameras.items():
        size = f"{camera.width} {camera.height}"
        out.append(f"{camera_id} {camera.model} {size} {_numbers(camera.params)}")
    return "\n".join(out) + "\n"


def images_to_text(images: list[ColmapImage]) -> str:
    """Contents of an images.txt."""
    out = ["# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME", "# X Y POINT3D_ID triples"]
    for image in images:
        pose = _numbers(np.concatenate([image.qvec, image.tvec]))
        out.append(f"{image.id} {pose} {image.camera_id} {image.name}")
        triples = zip(image.xys.tolist(), image.point3D_ids.tolist(), strict=True)
        out.append(" ".join(f"{x!r} {y!r} {i}" for (x, y), i in triples))
    return "\n".join(out) + "\n"


def points_to_text(points: ColmapPoints, tracks: np.ndarray, lengths: np.ndarray) -> str:
    """Contents of a points3D.txt; arguments as in `colmap_binary.points_to_bytes`."""
    out = ["# POINT3D_ID X Y Z R G B ERROR and pairs of IMAGE_ID POINT2D_IDX"]
    ends = np.cumsum(lengths)
    for i, end in enumerate(ends.tolist()):
        track = " ".join(map(str, tracks[end - lengths[i] : end].ravel().tolist()))
        r, g, b = points.rgb[i].tolist()
        error = float(points.error[i])
        out.append(
            f"{points.ids[i]} {_numbers(points.xyz[i])} {r} {g} {b} {error!r} {track}".strip()
        )
    return "\n".join(out) + "\n"


def _numbers(values: np.ndarray) -> str:
    # repr is the shortest text that reads back to the same double.
    return " ".join(repr(float(value)) for value in values)
