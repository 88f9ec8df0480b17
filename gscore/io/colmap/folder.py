"""COLMAP model folder, binary or text: reader and writer with numpy alone."""

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path, PurePosixPath, PureWindowsPath
from types import ModuleType

import numpy as np

from ...errors import DatasetError, FormatError
from ...quoting import quoted
from ...scene import FARTHEST, FOCAL_RANGE, PointCloud, is_focal
from ...text_format import count_words
from ..files import LONGEST_NAME, LONGEST_PATH, atomic_write, is_unnameable
from ..images.raw import RAW_ENDINGS
from ..images.read_image import IMAGE_ENDINGS
from ..ply.points import read_point_cloud
from ..unsupported_formats import describe_unsupported
from ..world_file import read_origin, read_up, write_up
from . import binary as colmap_binary
from . import text as colmap_text
from .model import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints, PointIndex, longest_seen

__all__ = [
    "ColmapCamera",
    "ColmapImage",
    "ColmapModel",
    "ColmapPoints",
    "find_model",
    "has_model",
    "read_model",
    "write_model",
]

_OTHER_PICTURES = (".heic", ".heif", ".avif", ".gif", *RAW_ENDINGS)
"""Endings of photos that are not read here."""
_POINT_CLOUDS = ("points3D.ply", "points3d.ply", "init.ply")
_ADVICE = (
    "Give the folder above `sparse`. Of photos alone `gscore sfm` finds the cameras; a training "
    "that found them keeps them in the folder `capture` of its output."
)


def has_model(folder: Path) -> bool:
    """Whether cameras and images of a model, binary or text, lie directly in `folder`."""
    return any(
        (folder / f"cameras{end}").is_file() and (folder / f"images{end}").is_file()
        for end in (".bin", ".txt")
    )


def find_model(path: str | Path) -> tuple[Path, tuple[str, ...]]:
    """Folder of the model in or at `path`, and sentences about a choice that had to be made.

    Looked for in this order: numbered folders in `path`/sparse, `path`/sparse, `path` itself,
    numbered folders in `path`, and the same under `path`/colmap. Of several numbered models the one
    with the most images is taken.

    Raises:
        DatasetError: there is none.
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
                f"{root} holds {len(numbered)} models that COLMAP could not join; using "
                f"{best.name} with {count_words(_count_images(best), 'image')}, leaving out "
                f"{others}.",
            )
        if has_model(root):
            return root, ()
    if not any(path.iterdir()):
        raise DatasetError(
            f"{path} is an empty folder. Give one with photos, or with photos and their cameras."
        )
    images = path / "images"
    if images.is_dir() and not any(map(_is_picture, images.rglob("*"))):
        raise DatasetError(
            f"There are no photos in {images}. Put some there, or give their folder."
        )
    raise DatasetError(
        f"No COLMAP model in {path}: expected cameras and images (.bin or .txt) in sparse/0, in "
        f"sparse or in the folder itself, or a transforms.json. "
        + (describe_unsupported(path) or _ADVICE)
    )


def _is_picture(path: Path) -> bool:
    """Whether it is one by its name, of a kind that is read here or of another."""
    return path.suffix.lower() in (*IMAGE_ENDINGS, *_OTHER_PICTURES)


def _no_folder(path: Path) -> str:
    """Why no capture is there."""
    if not path.is_file():
        return f"There is no folder {path}. Give the folder that holds the capture."
    return describe_unsupported(path) or (
        f"{path} is a file; a capture is a folder of photos, with their cameras or without. To "
        "train from the splats of a PLY, give the capture and --start-splats."
    )


def read_model(
    path: str | Path,
    *,
    observations: Callable[[ColmapPoints], bool] = lambda points: True,
    most: int | None = None,
) -> ColmapModel:
    """Read the COLMAP model in or at `path`.

    Args:
        path: A folder with `sparse/0` or `sparse`, or one that holds the files itself. Binary files
            win over text files. Missing points are allowed and give none.
        observations: Asked, with the points, whether images are wanted with what was observed in
            them: 24 bytes an observation, usually more than all else. Images without have none.
        most: Observations of points that are kept of each image, those of the points with the
            longest tracks; None: all, and those of no point too.

    Raises:
        DatasetError: there is no model.
        FormatError: a file is truncated or corrupt, a camera model is unknown, an id is there
            twice, an image's pose or name is unusable.
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
            f"called {' or '.join(_POINT_CLOUDS)}.",
        )
    images = _images(folder / f"images{end}", reader, cameras, observations(points))
    if most is not None:
        index = PointIndex(points)
        images = (longest_seen(image, points, index, most) for image in images)
    by_id = _by_id(folder / f"images{end}", images)
    named, told = _relative(folder / f"images{end}", list(by_id.values()))
    warnings = (*warnings, *told)
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
    """Write the model's three files into the folder `path`, and up and a local origin where they
    are known, each completely or not at all.

    Tracks are made from the images' observations; an observation of a point that is not in the
    model is written as one of no point, as COLMAP itself insists on.

    Raises:
        GsError: a file cannot be written.
    """
    path = Path(path)
    listed = [image.point3D_ids for image in model.images]
    joined = np.concatenate([np.zeros(0, np.int64), *listed])  # one search for all is far quicker
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
    for name, content in files.items():  # one right after the other: they belong together
        atomic_write(path / name, content)
    write_up(path, model.up, model.origin)


def is_safe_name(name: str) -> bool:
    """Whether a file name from a model stays inside the folder it is joined to, on any system, and
    a file can have it."""
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
    """The module that reads this folder (both have the same functions), and its file ending."""
    binary = (folder / "cameras.bin").is_file() and (folder / "images.bin").is_file()
    return (colmap_binary, ".bin") if binary else (colmap_text, ".txt")


def _count_images(folder: Path) -> int:
    reader, end = _reader(folder)
    return reader.count_images(folder / f"images{end}")


def _cameras(path: Path, reader: ModuleType) -> dict[int, ColmapCamera]:
    found: dict[int, ColmapCamera] = {}
    for camera_id, camera in reader.read_cameras(path):
        _check_camera(path, camera_id, camera)
        if camera_id in found:
            raise _twice(path, f"camera {camera_id}")
        found[camera_id] = camera
    return found


def _images(
    path: Path, reader: ModuleType, cameras: dict[int, ColmapCamera], observations: bool
) -> Iterator[ColmapImage]:
    """The images of a file, one at a time: what was observed in all of them may be too much."""
    for image in reader.read_images(path, observations=observations):
        _check_image(path, image, cameras)
        yield image


def _by_id(path: Path, images: Iterable[ColmapImage]) -> dict[int, ColmapImage]:
    found: dict[int, ColmapImage] = {}
    for image in images:
        if image.id in found:
            raise _twice(path, f"image {image.id}")
        found[image.id] = image
    return found


def _twice(path: Path, what: str) -> FormatError:
    return FormatError(
        f"{path}: {what} is there twice, expected each id once. Remove one of them, or export the "
        f"model anew from COLMAP."
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
            f"anew."
        )
    pose = np.concatenate([image.qvec, image.tvec])
    # NaN is within no limit.
    if not (np.abs(pose) <= FARTHEST).all() or not 1e-6 < np.abs(image.qvec).max() < 1e6:
        raise FormatError(
            f"{path}: image {quoted(image.name)} has the pose {pose.tolist()}; expected "
            f"numbers up to {FARTHEST:g} and a quaternion that is not zero. "
            f"Export the model anew from COLMAP."
        )
    if not is_safe_name("/".join(_inner(image.name))):
        raise FormatError(
            f"{path}: image {image.id} has the name {quoted(image.name)}; expected a path inside "
            f"the image folder, without '..' and with names of {LONGEST_NAME} bytes "
            f"at most. Run COLMAP with all images below one folder."
        )


def _inner(name: str) -> tuple[str, ...]:
    """Parts of a name without the root, drive or share of an absolute one."""
    whole = PureWindowsPath(name)
    return whole.parts[1:] if whole.anchor else (name,)


def _relative(path: Path, images: list[ColmapImage]) -> tuple[list[ColmapImage], tuple[str, ...]]:
    """The images with the file name alone where theirs is absolute, or with what lies below the
    folder that all absolute ones share, where file names are there twice; and a sentence on it.

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
            f"{path}: images have absolute names, of which the part below their folder is there "
            "twice. Export the model anew from COLMAP, with all images below one folder."
        )
    first = next(iter(parts))
    told = (
        f"{count_words(len(parts), 'image has an absolute name', 'images have absolute names')}; "
        f"used is what lies below their folder, {quoted(names[first])} of "
        f"{quoted(images[first].name)}."
    )
    return [replace(m, name=name) for m, name in zip(images, names, strict=True)], (told,)


def _point_cloud(folder: Path, source: Path) -> Path | None:
    """A PLY of points beside a model's files or in the folder of the capture."""
    places = dict.fromkeys((folder, folder.parent, source))
    files = (place / name for place in places for name in _POINT_CLOUDS)
    return next((file for file in files if file.is_file()), None)


def _without_tracks(cloud: PointCloud) -> ColmapPoints:
    """Points that no image observes: their ids are beyond those that COLMAP gives."""
    count = len(cloud)
    return ColmapPoints(
        ids=np.arange(count, dtype=np.int64) + (1 << 62),
        xyz=cloud.points,
        rgb=cloud.colors,
        error=np.full(count, -1.0),
        track_lengths=np.zeros(count, np.int32),
    )


def _tracks(images: list[ColmapImage], points: ColmapPoints) -> tuple[np.ndarray, np.ndarray]:
    """Observations [T, 2] (image id, index) point after point, and their number a point [P]."""
    empty = np.zeros(0, np.int64)
    sizes = [len(image.point3D_ids) for image in images]
    point_ids = np.concatenate([empty, *(image.point3D_ids for image in images)])
    image_ids = np.repeat(np.array([image.id for image in images], np.int64), sizes)
    indices = np.concatenate([empty, *(np.arange(size) for size in sizes)])
    seen = np.flatnonzero(point_ids != -1)
    order = np.argsort(points.ids, kind="stable")
    rank = order[np.searchsorted(points.ids, point_ids[seen], sorter=order)] if len(seen) else empty
    seen = seen[np.argsort(rank, kind="stable")]
    lengths = np.bincount(rank, minlength=len(points)).astype(np.int64)
    return np.stack([image_ids[seen], indices[seen]], axis=1), lengths
