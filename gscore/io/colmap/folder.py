"""COLMAP model folder, binary or text: reader and writer with numpy only."""

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path, PurePosixPath, PureWindowsPath
from types import ModuleType

import numpy as np

from ...errors import DatasetError, FormatError
from ...quoting import quoted
from ...scene import FARTHEST, FOCAL_RANGE, PointCloud, is_focal
from ...text_format import count_text
from ..cameras_json import read_origin, read_up, write_up
from ..files import LONGEST_NAME, LONGEST_PATH, atomic_write, is_unnameable
from ..images.raw import RAW_ENDINGS
from ..images.read_image import IMAGE_ENDINGS
from ..missing_path import missing_path
from ..ply.points import read_point_cloud
from ..unsupported_formats import describe_unsupported
from . import binary as colmap_binary
from . import text as colmap_text
from .model import (
    ColmapCamera,
    ColmapImage,
    ColmapModel,
    ColmapPoints,
    PointIndex,
    keep_longest_tracks,
)

_OTHER_PICTURES = (".heic", ".heif", ".avif", ".gif", *RAW_ENDINGS)
"""Endings of photos in unsupported formats."""
_MOST_NAMES = 10_000
"""Most names below a folder among which photos are looked for."""
_POINT_CLOUDS = ("points3D.ply", "points3d.ply", "init.ply")
_ADVICE = (
    "Give the folder above `sparse`. For photos without cameras, `gscore sfm` finds the cameras; a "
    "training that found them keeps them in the folder `capture` of its output."
)


def has_model(folder: Path) -> bool:
    """True if `folder` itself contains cameras and images of a model, binary or text."""
    return any(
        (folder / f"cameras{end}").is_file() and (folder / f"images{end}").is_file()
        for end in (".bin", ".txt")
    )


def find_model(path: str | Path) -> tuple[Path, tuple[str, ...]]:
    """Folder of the model in or at `path`, and a warning if several models were found.

    Order of the search: numbered folders in `path`/sparse, `path`/sparse, `path` itself, numbered
    folders in `path`, and the same under `path`/colmap. Among numbered models the one with the most
    images wins.

    Raises:
        DatasetError: no model was found.
    """
    path = Path(path)
    if not path.is_dir():
        raise DatasetError(_no_folder(path))
    for root in (path / "sparse", path, path / "colmap" / "sparse"):
        numbered = _numbered_models(root)
        if root == path and has_model(path):
            return path, ()
        if numbered:
            best = max(numbered, key=_count_images)  # the first of equals: the smallest number
            if len(numbered) == 1:
                return best, ()
            others = ", ".join(f"{m.name} ({_count_images(m)})" for m in numbered if m != best)
            return best, (
                f"{root} has {len(numbered)} models that COLMAP could not join; using "
                f"{best.name} with {count_text(_count_images(best), 'image')}, leaving out "
                f"{others}.",
            )
        if has_model(root):
            return root, ()
    if not any(path.iterdir()):
        raise DatasetError(
            f"{path} is an empty folder. Give one with photos, or with photos and cameras."
        )
    images = path / "images"
    if images.is_dir() and not any(map(_is_picture, images.rglob("*"))):
        raise DatasetError(
            f"There are no photos in {images}. Put some there, or give their folder."
        )
    known = describe_unsupported(path)
    if not known and not any(map(_is_picture, islice(path.rglob("*"), _MOST_NAMES))):
        raise DatasetError(
            f"There are no photos in {path} or its folders. Give a folder with photos, or with "
            "photos and cameras."
        )
    raise DatasetError(
        f"No COLMAP model in {path}: expected cameras and images (.bin or .txt) in sparse/0, in "
        f"sparse or in the folder itself, or a transforms.json. " + (known or _ADVICE)
    )


def _is_picture(path: Path) -> bool:
    """True if the name has the ending of a picture, of a supported format or not."""
    return path.suffix.lower() in (*IMAGE_ENDINGS, *_OTHER_PICTURES)


def _no_folder(path: Path) -> str:
    """Error message: `path` is not a folder with a capture."""
    if not path.is_file():
        return missing_path(path, advice="Give the folder of the capture, or a video.")
    return describe_unsupported(path) or (
        f"{path} is a file; a capture is a folder of photos, with or without cameras. To "
        "train from the splats of a PLY, give the capture and `--start-splats`."
    )


def read_model(
    path: str | Path,
    *,
    observations: Callable[[ColmapPoints], bool] = lambda points: True,
    most: int | None = None,
) -> ColmapModel:
    """Read the COLMAP model in or at `path`.

    Args:
        path: A folder with `sparse/0` or `sparse`, or with the files themselves. Binary files take
            precedence over text files. A missing points file gives a model without points.
        observations: Called with the points; returns whether to read the images' observations,
            24 bytes each and usually most of the model. If not, the images have none.
        most: Most observations kept per image, those of the points with the longest tracks; None:
            all, also those without a point.

    Raises:
        DatasetError: there is no model.
        FormatError: a file is truncated or corrupt, a camera model is unknown, an id occurs twice,
            an image's pose or name is unusable.
    """
    folder, warnings = find_model(path)
    reader, end = _reader(folder)
    cameras = _cameras(folder / f"cameras{end}", reader)
    points_file = folder / f"points3D{end}"
    points = reader.read_points(points_file) if points_file.is_file() else ColmapPoints.none()
    if not len(points) and (file := _point_cloud(folder, Path(path))) is not None:
        points = _without_tracks(read_point_cloud(file))
        warnings = (*warnings, f"The model has no points of its own; those of {file} are used.")
    elif not points_file.is_file():
        warnings = (
            *warnings,
            f"{points_file} is missing; the model has no points. Put it there, or a PLY of points "
            f"named {' or '.join(_POINT_CLOUDS)}.",
        )
    images = _images(folder / f"images{end}", reader, cameras, observations(points))
    if most is not None:
        index = PointIndex(points)
        images = (keep_longest_tracks(image, points, index, most) for image in images)
    by_id = _by_id(folder / f"images{end}", images)
    named, renamed = _relative(folder / f"images{end}", list(by_id.values()))
    warnings = (*warnings, *renamed)
    return ColmapModel(
        cameras=cameras,
        images=named,
        points=points,
        path=folder,
        warnings=warnings,
        up=read_up(folder),
        origin=read_origin(folder),
    )


def write_model(model: ColmapModel, path: str | Path, *, binary: bool = True) -> None:
    """Write the model's three files into the folder `path`, and the up direction and local origin
    if they are known; each file completely or not at all.

    Tracks are built from the images' observations. An observation of a point that is not in the
    model is written without a point, as COLMAP requires.

    Raises:
        GsError: a file cannot be written.
    """
    path = Path(path)
    listed = [image.point3D_ids for image in model.images]
    joined = np.concatenate([np.zeros(0, np.int64), *listed])  # one search for all is much faster
    joined = np.where(np.isin(joined, model.points.ids), joined, -1)
    parts = np.split(joined, np.cumsum([len(ids) for ids in listed])[:-1]) if listed else []
    images = [
        replace(image, point3D_ids=ids) for image, ids in zip(model.images, parts, strict=True)
    ]
    tracks, lengths = _tracks(images, model.points)
    if binary:
        files = {
            "cameras.bin": colmap_binary.cameras_to_bytes(model.cameras),
            "images.bin": colmap_binary.images_to_bytes(images),
            "points3D.bin": colmap_binary.points_to_bytes(model.points, tracks, lengths),
        }
    else:
        texts = {
            "cameras.txt": colmap_text.cameras_to_text(model.cameras),
            "images.txt": colmap_text.images_to_text(images),
            "points3D.txt": colmap_text.points_to_text(model.points, tracks, lengths),
        }
        files = {name: text.encode("utf-8") for name, text in texts.items()}
    for name, content in files.items():  # in quick succession: they belong together
        atomic_write(path / name, content)
    write_up(path, model.up, model.origin)


def is_safe_name(name: str) -> bool:
    """True if a file name from a model is valid and stays inside the folder it is joined to, on
    any system."""
    if len(name) > LONGEST_PATH:
        return False
    posix, windows = PurePosixPath(name), PureWindowsPath(name)
    return (
        bool(windows.parts)
        and not posix.is_absolute()
        and not windows.drive
        and not windows.root
        and ".." not in windows.parts
        and all(len(part.encode("utf-8", "replace")) <= LONGEST_NAME for part in windows.parts)
        and not any(map(is_unnameable, name))
    )


def _numbered_models(root: Path) -> list[Path]:
    if not root.is_dir():
        return []
    folders = [f for f in root.iterdir() if re.fullmatch(r"\d+", f.name) and has_model(f)]
    return sorted(folders, key=lambda f: int(f.name))


def _reader(folder: Path) -> tuple[ModuleType, str]:
    """Module that reads this folder (both have the same functions), and its file ending."""
    binary = (folder / "cameras.bin").is_file() and (folder / "images.bin").is_file()
    return (colmap_binary, ".bin") if binary else (colmap_text, ".txt")


def _count_images(folder: Path) -> int:
    reader, end = _reader(folder)
    return reader.count_images(folder / f"images{end}")


def _cameras(path: Path, reader: ModuleType) -> dict[int, ColmapCamera]:
    cameras: dict[int, ColmapCamera] = {}
    for camera_id, camera in reader.read_cameras(path):
        _check_camera(path, camera_id, camera)
        if camera_id in cameras:
            raise _duplicate_id(path, f"camera {camera_id}")
        cameras[camera_id] = camera
    return cameras


def _images(
    path: Path, reader: ModuleType, cameras: dict[int, ColmapCamera], observations: bool
) -> Iterator[ColmapImage]:
    """Checked images of a file, one at a time: the observations of all may not fit in memory."""
    for image in reader.read_images(path, observations=observations):
        _check_image(path, image, cameras)
        yield image


def _by_id(path: Path, images: Iterable[ColmapImage]) -> dict[int, ColmapImage]:
    by_id: dict[int, ColmapImage] = {}
    for image in images:
        if image.id in by_id:
            raise _duplicate_id(path, f"image {image.id}")
        by_id[image.id] = image
    return by_id


def _duplicate_id(path: Path, what: str) -> FormatError:
    return FormatError(
        f"{path}: {what} occurs twice, expected each id once. Remove one of them, or export the "
        f"model from COLMAP again."
    )


def _check_camera(path: Path, camera_id: int, camera: ColmapCamera) -> None:
    size_ok = 0 < camera.width < 2**31 and 0 < camera.height < 2**31
    focal = [v for n, v in camera.named_params.items() if n in ("f", "fx", "fy")]
    if (
        not 0 <= camera_id < 2**32
        or not size_ok
        or not (np.abs(camera.params) <= FARTHEST).all()
        or not all(is_focal(v, camera.width, camera.height) for v in focal)
    ):
        raise FormatError(
            f"{path}: camera {quoted(camera_id)} ({camera.model}) has the size "
            f"{quoted(camera.width)} x {quoted(camera.height)} and the parameters "
            f"{camera.params.tolist()}; "
            f"expected a positive size, focal lengths of {FOCAL_RANGE[0]:g} to {FOCAL_RANGE[1]:g} "
            f"times its longer side and numbers up to {FARTHEST:g}. Run COLMAP again."
        )


def _check_image(path: Path, image: ColmapImage, cameras: dict[int, ColmapCamera]) -> None:
    if not 0 <= image.id < 2**32:
        raise FormatError(
            f"{path}: image {quoted(image.name)} has the id {quoted(image.id)}, expected 0 to 2^32."
        )
    if image.camera_id not in cameras:
        raise FormatError(
            f"{path}: image {quoted(image.name)} uses camera {quoted(image.camera_id)}, which "
            f"the model does not have. The files of the model do not belong together; export it "
            f"again."
        )
    pose = np.concatenate([image.qvec, image.tvec])
    # NaN fails every comparison.
    if not (np.abs(pose) <= FARTHEST).all() or not 1e-6 < np.abs(image.qvec).max() < 1e6:
        raise FormatError(
            f"{path}: image {quoted(image.name)} has the pose {pose.tolist()}; expected "
            f"numbers up to {FARTHEST:g} and a quaternion that is not zero. "
            f"Export the model from COLMAP again."
        )
    if not is_safe_name("/".join(_inner(image.name))):
        raise FormatError(
            f"{path}: image {image.id} has the name {quoted(image.name)}; expected a path inside "
            f"the image folder, without '..' and with names of {LONGEST_NAME} bytes "
            f"at most. Run COLMAP with all images below one folder."
        )


def _inner(name: str) -> tuple[str, ...]:
    """Parts of a name, without root, drive or share."""
    whole = PureWindowsPath(name)
    return whole.parts[1:] if whole.anchor else (name,)


def _relative(path: Path, images: list[ColmapImage]) -> tuple[list[ColmapImage], tuple[str, ...]]:
    """The images with absolute names made relative, and a warning about it: the file name alone,
    or, if file names repeat, the path below the folder that all absolute names share.

    Raises:
        FormatError: the names are still not unique.
    """
    parts = {i: _inner(m.name) for i, m in enumerate(images) if PureWindowsPath(m.name).anchor}
    if not parts:
        return images, ()
    names = [image.name for image in images]
    shared = 0
    while len({p[:shared] for p in parts.values()}) == 1 and all(
        len(p) > shared for p in parts.values()
    ):
        shared += 1
    for begin in (-1, shared - 1):
        for i, inner in parts.items():
            names[i] = "/".join(inner[begin:])
        if len(set(names)) == len(names):
            break
    else:
        raise FormatError(
            f"{path}: images have absolute names that are not unique below their common folder. "
            "Export the model from COLMAP again, with all images below one folder."
        )
    first = next(iter(parts))
    warning = (
        f"{count_text(len(parts), 'image has an absolute name', 'images have absolute names')}; "
        f"gscore uses the path below their folder, {quoted(names[first])} for "
        f"{quoted(images[first].name)}."
    )
    return [replace(m, name=name) for m, name in zip(images, names, strict=True)], (warning,)


def _point_cloud(folder: Path, source: Path) -> Path | None:
    """A PLY of points next to a model's files or in the folder of the capture."""
    folders = dict.fromkeys((folder, folder.parent, source))
    files = (parent / name for parent in folders for name in _POINT_CLOUDS)
    return next((file for file in files if file.is_file()), None)


def _without_tracks(cloud: PointCloud) -> ColmapPoints:
    """Points without observations, with ids beyond those that COLMAP assigns."""
    count = len(cloud)
    return ColmapPoints(
        ids=np.arange(count, dtype=np.int64) + (1 << 62),
        xyz=cloud.points,
        rgb=cloud.colors,
        error=np.full(count, -1.0),
        track_lengths=np.zeros(count, np.int32),
    )


def _tracks(images: list[ColmapImage], points: ColmapPoints) -> tuple[np.ndarray, np.ndarray]:
    """Observations [T, 2] (image id, index) ordered by point, and their number per point [P]."""
    empty = np.zeros(0, np.int64)
    sizes = [len(image.point3D_ids) for image in images]
    point_ids = np.concatenate([empty, *(image.point3D_ids for image in images)])
    image_ids = np.repeat(np.array([image.id for image in images], np.int64), sizes)
    indices = np.concatenate([empty, *(np.arange(size) for size in sizes)])
    used = np.flatnonzero(point_ids != -1)
    order = np.argsort(points.ids, kind="stable")
    rank = order[np.searchsorted(points.ids, point_ids[used], sorter=order)] if len(used) else empty
    used = used[np.argsort(rank, kind="stable")]
    lengths = np.bincount(rank, minlength=len(points)).astype(np.int64)
    return np.stack([image_ids[used], indices[used]], axis=1), lengths
