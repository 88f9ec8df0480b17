"""PKU-DyMVHumans cams: video frames with their own COLMAP models, or with the rig's cams/*.txt."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...config import DataConfig
from ...errors import DatasetError, FormatError
from ...io.colmap.folder import has_model
from ...io.colmap.model import ColmapCamera
from ...io.files import read_bytes
from ...io.images.read_image import read_info
from ...quoting import brief, first_few, quoted
from ...scene import PointCloud
from ...text_format import count_text
from ..capture import Capture, View
from ..colmap_source import read_colmap
from ..poses import pinhole_camera, rigid_matrix
from .photos import VIEW_FOLDER, camera_number, mattes, photo_folder_name, pictures_by_camera

_NAME = re.compile(r"(\d+)_cam\.txt", re.IGNORECASE)


def list_cams(folder: Path) -> dict[int, Path]:
    """Files `<number>_cam.txt` of a folder by number, ascending.

    Raises:
        DatasetError: there is no such folder or no such file, or a number occurs twice.
    """
    if not folder.is_dir():
        raise DatasetError(
            f"There is no folder {folder} with the files <number>_cam.txt of the cameras."
        )
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        match = _NAME.fullmatch(path.name)
        if match is None:
            continue
        number = int(match[1])
        if number in found:
            raise DatasetError(
                f"{folder} has camera {number} twice, {found[number].name} and {path.name}. "
                f"Remove the wrong one."
            )
        found[number] = path
    if not found:
        raise DatasetError(f"{folder} has no file <number>_cam.txt. Copy the cameras into it.")
    return dict(sorted(found.items()))


def read_cam(path: Path) -> tuple[list[list[float]], list[list[float]]]:
    """Extrinsic matrix, 4 x 4, world to camera in OpenCV axes, and intrinsic matrix, 3 x 3, pixels.

    The depth range and interval after them are ignored.

    Raises:
        DatasetError: the file is missing.
        FormatError: it is not text, or a matrix is missing or has too few numbers.
    """
    try:
        words = read_bytes(path).decode("utf-8-sig").split()
    except UnicodeDecodeError as error:
        raise FormatError(f"{path} is not text. Copy the camera file again.") from error
    lower = [word.lower() for word in words]
    return _matrix(path, words, lower, "extrinsic", 4), _matrix(path, words, lower, "intrinsic", 3)


def _matrix(
    path: Path, words: list[str], lower: list[str], name: str, size: int
) -> list[list[float]]:
    """Parse `size` x `size` numbers after the word `name`."""
    layout = f"the word {quoted(name)} and {size * size} numbers after it"
    if name not in lower:
        raise FormatError(
            f"{path} has no {quoted(name)}; expected {layout}. Copy the camera file again."
        )
    at = lower.index(name) + 1
    try:
        values = np.array([float(word) for word in words[at : at + size * size]])
    except ValueError as error:
        raise FormatError(
            f"{path}: {brief(error)} in the {name} matrix; expected {layout}. Copy the camera "
            f"file again."
        ) from error
    if len(values) != size * size:
        raise FormatError(
            f"{path} ends within the {name} matrix ({len(values)} numbers); expected {layout}. "
            f"Copy the camera file again."
        )
    return values.reshape(size, size).tolist()


_SAME = 0.02
"""Largest relative difference between twice the principal point and the size of the photo."""


def read_model_frame(
    config: DataConfig, case: Path, path: Path, frame: int, photos_required: bool
) -> Capture:
    """`data_COLMAP/<frame>`: photos, mattes and a COLMAP model in `sparse` or `sparse/0`."""
    images = photo_folder_name(path, config.images) if photos_required else config.images
    options = replace(config, source=path, images=images)
    capture = read_colmap(options, photos_required=photos_required)
    soft = mattes(path, images)
    numbers = [camera_number(view.name) for view in capture.views]
    views = [
        replace(view, mask=None if number is None else soft.get(number))
        for view, number in zip(capture.views, numbers, strict=True)
    ]
    return replace(capture, views=views)


def read_per_frame(
    config: DataConfig, case: Path, path: Path, frame: int, photos_required: bool
) -> Capture:
    """`per_frame/<frame>`: photos and mattes; cameras from its own model, else from `cams`."""
    if any(has_model(path / name) for name in ("sparse/0", "sparse")):
        return read_model_frame(config, case, path, frame, photos_required)
    images = photo_folder_name(path, config.images)
    photos = pictures_by_camera(path / images)
    if not photos:
        raise DatasetError(
            f"{path / images} has no photo of a known camera; expected names like "
            f"image_c_000_f_{frame:06d}.png. Give the photo folder with `--images`."
        )
    names = {number: photo.name for number, photo in photos.items()}
    return _with_cams(case, path, photos, names, mattes(path, images))


def read_per_view(
    config: DataConfig, case: Path, path: Path, frame: int, photos_required: bool
) -> Capture:
    """`per_view/cam_<i>/{images,pha,com}/<frame>.png`, cameras from `cams`."""
    photos: dict[int, Path] = {}
    soft: dict[int, Path] = {}
    missing = []
    for folder in sorted(path.iterdir()):
        match = VIEW_FOLDER.fullmatch(folder.name)
        if match is None or not folder.is_dir():
            continue
        number = int(match[1])
        images = photo_folder_name(folder, config.images)
        # Pictures of a view are numbered by frame, so the "camera number" is the frame here.
        photo = pictures_by_camera(folder / images).get(frame)
        if photo is None:
            missing.append(folder.name)
            continue
        photos[number] = photo
        if matte := mattes(folder, images).get(frame):
            soft[number] = matte
    total = len(photos) + len(missing)
    if 2 * len(missing) > total or not photos:
        raise DatasetError(
            f"Frame {frame} is missing in {len(missing)} of the {count_text(total, 'view')} in "
            f"{path}: {first_few(missing)}. Extract the frames of all videos."
        )
    names = {number: f"image_c_{number:03d}_f_{frame:06d}.png" for number in photos}
    capture = _with_cams(case, path, photos, names, soft)
    if not missing:
        return capture
    warning = f"Frame {frame} is missing in {len(missing)} of the {count_text(total, 'view')}: "
    return replace(capture, warnings=(*capture.warnings, f"{warning}{first_few(missing)}."))


def _with_cams(
    case: Path, root: Path, photos: dict[int, Path], names: dict[int, str], soft: dict[int, Path]
) -> Capture:
    """The photos with the cameras of `case`/cams; all by camera number."""
    cams = list_cams(case / "cams")
    without = [names[number] for number in photos if number not in cams]
    if without:
        # Cameras that COLMAP could not place are skipped in the numbering of these files, so later
        # files would belong to other photos.
        raise DatasetError(
            f"{case / 'cams'} has {count_text(len(cams), 'camera')}, numbers {min(cams)} to "
            f"{max(cams)}, but "
            f"none for {len(without)} of the {count_text(len(photos), 'photo')} in {root}: "
            f"{first_few(without)}. "
            f"Number the camera files as the photos, or use another layout of the data set."
        )
    warnings = []
    unused = [cams[number].name for number in cams if number not in photos]
    if unused:
        warnings.append(
            f"No photo belongs to {len(unused)} of the cameras in {case / 'cams'}: "
            f"{first_few(unused)}."
        )
    views = []
    for number, photo in photos.items():
        path = cams[number]
        extrinsic, intrinsic = read_cam(path)
        views.append(
            View(
                name=names[number],
                image=photo,
                viewmat=rigid_matrix(str(path), "extrinsic", extrinsic),
                camera=_camera(path, intrinsic, photo),
                mask=soft.get(number),
            )
        )
    return Capture(root=root, views=views, points=PointCloud.none(), warnings=tuple(warnings))


def _camera(path: Path, intrinsic: list[list[float]], photo: Path) -> ColmapCamera:
    """Camera at its calibrated size, which the file does not state.

    COLMAP keeps the principal point in the middle, so twice that is the size. It is smaller than
    the photo if the photos were downscaled before the export (4K ones to 2000 px).
    """
    info = read_info(photo)
    width, height = 2 * intrinsic[0][2], 2 * intrinsic[1][2]
    near = [abs(a - b) <= _SAME * b for a, b in ((width, info.width), (height, info.height))]
    if all(near):
        return pinhole_camera(str(path), "intrinsic", intrinsic, info.width, info.height)
    if not width > 0 or abs(height * info.width / (width * info.height) - 1) > _SAME:
        raise DatasetError(
            f"{path} belongs to photos of about {width:.0f} x {height:.0f} pixels (its principal "
            f"point is their middle), but {photo} is {info.width} x {info.height}. Use the photos "
            f"that the cameras were made for, or these scaled without cropping."
        )
    return pinhole_camera(str(path), "intrinsic", intrinsic, round(width), round(height))
