"""COLMAP's text files: cameras.txt, images.txt, points3D.txt."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..errors import FormatError
from .camera_models import MODELS_BY_NAME
from .colmap_model import ColmapCamera, ColmapImage, ColmapPoints
from .files import read_bytes


def _lines(path: Path) -> list[str]:
    try:
        return read_bytes(path).decode("utf-8").split("\n")
    except UnicodeDecodeError as error:
        raise FormatError(
            f"{path} is not UTF-8 text (byte {error.start}). Export the model anew from COLMAP."
        ) from error


def _records(lines: list[str]) -> Iterator[tuple[int, str]]:
    for i, line in enumerate(lines):
        if line.strip() and not line.lstrip().startswith("#"):
            yield i, line


def _bad(path: Path, line: int, expected: str) -> FormatError:
    return FormatError(
        f"{path} line {line + 1} is truncated or corrupt: expected {expected}. "
        f"Copy the model again or export it anew from COLMAP."
    )


def read_cameras(path: Path) -> dict[int, ColmapCamera]:
    """Cameras of a cameras.txt by id."""
    cameras = {}
    for at, line in _records(_lines(path)):
        words = line.split()
        model = MODELS_BY_NAME.get(words[1]) if len(words) > 1 else None
        if len(words) > 1 and model is None:
            raise FormatError(
                f"{path} line {at + 1}: camera {words[0]} has the unknown camera model "
                f"{words[1]!r}, known are {', '.join(MODELS_BY_NAME)}. Undistort the capture with "
                f"COLMAP, or update gscore."
            )
        expected = "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]"
        if model is None or len(words) != 4 + len(model.params):
            raise _bad(path, at, expected)
        try:
            cameras[int(words[0])] = ColmapCamera(
                model=model.name,
                width=int(words[2]),
                height=int(words[3]),
                params=np.array([float(word) for word in words[4:]]),
            )
        except ValueError as error:
            raise _bad(path, at, expected) from error
    return cameras


def count_images(path: Path) -> int:
    """Number of images an images.txt holds."""
    return len(read_images(path))


def read_images(path: Path) -> list[ColmapImage]:
    """Images of an images.txt in file order: two lines each, the second may be empty."""
    lines = _lines(path)
    images, at = [], 0
    while at < len(lines):
        line = lines[at]
        if not line.strip() or line.lstrip().startswith("#"):
            at += 1
            continue
        words = line.split(maxsplit=9)
        expected = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
        if len(words) < 10:
            raise _bad(path, at, expected)
        try:
            pose = np.array([float(word) for word in words[1:8]])
            image_id, camera_id = int(words[0]), int(words[8])
        except ValueError as error:
            raise _bad(path, at, expected) from error
        seen = lines[at + 1].split() if at + 1 < len(lines) else []
        try:
            if len(seen) % 3:
                raise ValueError
            numbers = np.array(seen, dtype=np.str_).reshape(-1, 3)
            xys = numbers[:, :2].astype(np.float64)
            ids = numbers[:, 2].astype(np.int64)
        except (ValueError, OverflowError) as error:
            raise _bad(path, at + 1, "triples of X Y POINT3D_ID") from error
        images.append(
            ColmapImage(
                id=image_id,
                name=words[9].rstrip(),
                camera_id=camera_id,
                qvec=pose[:4],
                tvec=pose[4:],
                xys=xys,
                point3D_ids=ids,
            )
        )
        at += 2
    return images


def read_points(path: Path) -> ColmapPoints:
    """Points of a points3D.txt in file order."""
    ids, numbers, colors, lengths = [], [], [], []
    for at, line in _records(_lines(path)):
        words = line.split()
        try:
            if len(words) < 8 or len(words) % 2:
                raise ValueError
            ids.append(int(words[0]))
            numbers.append([float(words[k]) for k in (1, 2, 3, 7)])
            colors.append([int(word) for word in words[4:7]])
            if not -(2**63) <= ids[-1] < 2**63 or not all(0 <= c <= 255 for c in colors[-1]):
                raise ValueError
        except ValueError as error:
            expected = "POINT3D_ID X Y Z R G B ERROR and pairs of IMAGE_ID POINT2D_IDX"
            raise _bad(path, at, expected) from error
        lengths.append(len(words) // 2 - 4)
    table = np.array(numbers, np.float64).reshape(-1, 4)
    return ColmapPoints(
        ids=np.array(ids, np.int64),
        xyz=np.ascontiguousarray(table[:, :3]),
        rgb=np.array(colors, np.uint8).reshape(-1, 3),
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
        seen = zip(image.xys.tolist(), image.point3D_ids.tolist(), strict=True)
        out.append(" ".join(f"{x!r} {y!r} {i}" for (x, y), i in seen))
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
