"""PKU-DyMVHumans case: layout of a multi-view video, and one of its frames; the layout of NeuS."""

import os
import re
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from ...config import DataConfig
from ...errors import ConfigError, DatasetError, FormatError, GsError
from ...io.images.read_image import read_info
from ...io.npy import read_npy
from ...quoting import brief, first_few
from ...scene import FARTHEST, PointCloud
from ...text_format import count_text
from ..capture import Capture, View
from ..colmap_source import read_colmap
from ..poses import pinhole_camera, rigid_matrix
from ..rig import with_rig
from . import cams as pku_cams
from . import json_layouts as pku_json
from .photos import VIEW_FOLDER, mattes, photo_folder_name, pictures_by_camera

_FILE = "cameras_sphere.npz"
_MATRIX_BYTES = 1 << 16


def read_neus(
    config: DataConfig, case: Path, path: Path, frame: int, photos_required: bool
) -> Capture:
    """`data_NeuS/<frame>`: `images`, `mask` and the `world_mat_<i>` of cameras_sphere.npz.

    `scale_mat_<i>`, which moves the people into the unit sphere, is not applied: the world stays
    that of structure from motion.

    Raises:
        DatasetError: photos are missing, or their number differs from that of the cameras.
        FormatError: the npz is corrupt or its matrices are not cameras.
    """
    projections = _projections(path / _FILE)
    images = photo_folder_name(path, config.images)
    photos = pictures_by_camera(path / images)
    # Matrices follow the order of the sorted photos, not their numbers.
    if len(photos) != len(projections):
        raise DatasetError(
            f"{path / _FILE} has {count_text(len(projections), 'camera')}, {path / images} has "
            f"{len(photos)} "
            f"numbered photos ({first_few([photo.name for photo in photos.values()])}). Copy the "
            f"frame again."
        )
    soft = mattes(path, images)
    views = []
    for i, (number, photo) in enumerate(photos.items()):
        info = read_info(photo)
        where, key = str(path / _FILE), f"world_mat_{i}"
        K, viewmat = _decompose(projections[i])
        views.append(
            View(
                name=photo.name,
                image=photo,
                viewmat=rigid_matrix(where, key, viewmat),
                camera=pinhole_camera(where, key, K, info.width, info.height),
                mask=soft.get(number),
            )
        )
    return Capture(root=path, views=views, points=PointCloud.none())


def _projections(path: Path) -> list[np.ndarray]:
    """[3, 4] float64 projection matrices `world_mat_0`, `world_mat_1`, ..."""
    if not path.is_file():
        raise DatasetError(f"There is no {path} with the cameras. Copy the frame again.")
    try:
        with zipfile.ZipFile(path) as stored:
            matrices = re.compile(r"world_mat_\d+\.npy")
            count = sum(1 for name in stored.namelist() if matrices.fullmatch(name))
            projections = [_matrix(stored, f"world_mat_{i}.npy") for i in range(count)]
    except Exception as error:  # damaged archives raise about ten kinds
        raise FormatError(
            f"{path} cannot be read as an npz with world_mat_0, world_mat_1, ...: {brief(error)}. "
            f"Copy the frame again."
        ) from error
    for i, matrix in enumerate(projections):
        if matrix.shape not in ((3, 4), (4, 4)) or not (np.abs(matrix) <= FARTHEST).all():
            raise FormatError(
                f"{path}: world_mat_{i} is {matrix.tolist()}, expected 4 x 4 numbers up to "
                f"{FARTHEST:g}. Copy the frame again."
            )
    if not projections:
        raise FormatError(f"{path} has no world_mat_0. Copy the frame again.")
    return [matrix[:3] for matrix in projections]


def _matrix(stored: zipfile.ZipFile, name: str) -> np.ndarray:
    with stored.open(name) as file:
        raw = file.read(_MATRIX_BYTES)  # limits the unpacked size
    return read_npy(raw).astype(np.float64)


def _decompose(projection: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """K [3, 3] with K[2, 2] = 1 and world to camera [4, 4], from K [R | t] [3, 4] up to scale."""
    # RQ by QR of the flipped matrix: with J the exchange matrix, M = R Q from (J M)^T = Q' R'.
    flip = np.eye(3)[::-1]
    q, r = np.linalg.qr((flip @ projection[:, :3]).T)
    K, rotation = flip @ r.T @ flip, flip @ q.T
    signs = np.diag(np.where(np.diag(K) < 0, -1.0, 1.0))
    K, rotation = K @ signs, signs @ rotation
    translation = np.linalg.solve(K, projection[:, 3]) if np.linalg.det(K) else np.zeros(3)
    if np.linalg.det(rotation) < 0:  # the projection had a negative sign
        rotation, translation = -rotation, -translation
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = rotation, translation
    K = K / K[2, 2] if K[2, 2] else np.zeros((3, 3))
    return np.triu(K), viewmat


_NUMBER = re.compile(r"\d+")
_NEUS2 = re.compile(r"transforms?_(\d+)\.json")
_SPLITS = ("train", "test")


@dataclass(frozen=True, kw_only=True)
class PkuVideo:
    """A scenario of the data set, with the requested layout and frame."""

    case: Path
    """Folder of the scenario, with `cams`, `per_frame`, `data_COLMAP` and so on."""
    layout: str
    """Name of a folder in it, a key of `LAYOUTS`; empty: the first that has the frame."""
    frame: int | None
    """Number of the frame in the path; None: none."""

    def frames(self) -> dict[int, Path]:
        """Paths by frame number, ascending, of the layout or of the first that has frames.

        Each path identifies one frame, except in `per_view`, where it is that folder.

        Raises:
            DatasetError: there are none.
        """
        for layout in (self.layout,) if self.layout else LAYOUTS:
            paths = _list(self.case / layout, layout)
            if paths and self.frame is None:
                return paths
            if self.frame in paths:
                return {self.frame: paths[self.frame]}
        raise _no_frame(self, self.frame)


def find_video(source: Path) -> PkuVideo | None:
    """Scenario, layout and frame of a path in one of the data set's layouts, or None for others.

    A folder that also has a COLMAP model in `sparse` is an ordinary capture.
    """
    path = Path(os.path.abspath(source))  # noqa: PTH100 - the names may be those of links
    names = [path.name, path.parent.name, path.parent.parent.name]
    if path.is_file():
        number = _NEUS2.fullmatch(names[0])
        root = path.parent.parent if names[1] in _SPLITS else path.parent
        if number is None or root.name != "data_NeuS2":
            return None
        return PkuVideo(case=root.parent, layout=root.name, frame=int(number[1]))
    if not path.is_dir():
        return None
    if names[0] in LAYOUTS:
        return PkuVideo(case=path.parent, layout=names[0], frame=None)
    if names[1] in _FOLDER_A_FRAME and _NUMBER.fullmatch(names[0]):
        return PkuVideo(case=path.parent.parent, layout=names[1], frame=int(names[0]))
    if any((path / name).is_dir() for name in LAYOUTS) and not (path / "sparse").is_dir():
        return PkuVideo(case=path, layout="", frame=None)
    return None


def read_video(video: PkuVideo, config: DataConfig, *, photos_required: bool = True) -> Capture:
    """Read one frame: that of `config.frame`, that of the path, or the first.

    Raises:
        ConfigError: the path and the option give different frames.
        DatasetError: there is no such frame, or files of it are missing.
        FormatError: a file is truncated, corrupt or of another format.
    """
    frame_number = video.frame if config.frame is None else config.frame
    if video.frame is not None and frame_number != video.frame:
        raise ConfigError(
            f"{config.source} is frame {video.frame}, but `--frame` is {frame_number}. Give the "
            f"folder above it, or leave `--frame` out."
        )
    layouts = (video.layout,) if video.layout else tuple(LAYOUTS)
    for layout in layouts:
        listed = _list(video.case / layout, layout)
        if listed and (frame_number is None or frame_number in listed):
            break
    else:
        raise _no_frame(video, frame_number)
    frame = next(iter(listed)) if frame_number is None else frame_number
    capture = LAYOUTS[layout](config, video.case, listed[frame], frame, photos_required)
    warnings = list(capture.warnings)
    points = capture.points
    if len(points) == 0:
        points, notes = _points_of_colmap(video.case, frame, capture, listed[frame])
        warnings += notes
    if frame_number is None and len(listed) > 1:
        warnings.append(
            f"{video.case / layout} contains {count_text(len(listed), 'frame')}, {_span(listed)}; "
            f"using frame {frame}. Choose another with `--frame`."
        )
    return replace(capture, points=points, masks_are="composite", warnings=tuple(warnings))


def _points_of_colmap(
    case: Path, frame: int, capture: Capture, path: Path
) -> tuple[PointCloud, list[str]]:
    """SfM points of the frame, or of the nearest one, moved to the world of a capture without
    points."""
    models = _list(case / "data_COLMAP", "data_COLMAP")
    if not models:
        return capture.points, []
    folder = models[min(models, key=lambda number: abs(number - frame))]
    try:
        model = read_colmap(DataConfig(source=folder), photos_required=False)
        points = with_rig(model, capture, where=folder, rig_at=path).points
    except GsError as error:
        return capture.points, [f"The points of {folder} cannot be used: {error}"]
    warning = f"{path} has no points; starting from those of {folder}, moved into its world."
    return points, [warning]


Reader = Callable[[DataConfig, Path, Path, int, bool], Capture]
"""Reads (options, scenario, path of the frame, number of the frame, whether photos must exist)."""

LAYOUTS: dict[str, Reader] = {
    "data_COLMAP": pku_cams.read_model_frame,
    "per_frame": pku_cams.read_per_frame,
    "per_view": pku_cams.read_per_view,
    "data_NeuS2": pku_json.read_neus2,
    "data_ngp": pku_json.read_ngp,
    "data_NeuS": read_neus,
}
"""Folders of a scenario, best first: layouts with SfM points and original photos come first."""

_FOLDER_A_FRAME = ("data_COLMAP", "per_frame", "data_ngp", "data_NeuS")
_EXAMPLES = {
    "": "000000",
    "data_COLMAP": "000000",
    "per_frame": "000000",
    "per_view": "cam_0/images/000000.png",
    "data_NeuS2": "transform_000000.json",
    "data_ngp": "000000",
    "data_NeuS": "000000",
}


def _list(folder: Path, layout: str) -> dict[int, Path]:
    """Frames of one layout by number, ascending; empty if it has none."""
    if not folder.is_dir():
        return {}
    found: dict[int, Path] = {}
    if layout in _FOLDER_A_FRAME:
        for path in folder.iterdir():
            if _NUMBER.fullmatch(path.name) and path.is_dir():
                found[int(path.name)] = path
    elif layout == "data_NeuS2":
        for place in (
            folder / "test",
            folder / "train",
            folder,
        ):  # the complete file overrides the splits
            for path in place.iterdir() if place.is_dir() else ():
                if match := _NEUS2.fullmatch(path.name):
                    found[int(match[1])] = path
    else:
        views = [f for f in folder.iterdir() if VIEW_FOLDER.fullmatch(f.name) and f.is_dir()]
        for name in ("images", "image"):
            for photo in (photo for view in views for photo in (view / name).glob("*.*")):
                if _NUMBER.fullmatch(photo.stem):
                    found[int(photo.stem)] = folder
    return dict(sorted(found.items()))


def _no_frame(video: PkuVideo, frame_number: int | None) -> DatasetError:
    listed = {
        name: frames
        for name in ((video.layout,) if video.layout else LAYOUTS)
        if (frames := _list(video.case / name, name))
    }
    where = video.case / video.layout
    if not listed:
        return DatasetError(
            f"{where} contains no frames; expected folders or files with their numbers, as in "
            f"{video.layout or 'data_COLMAP'}/{_EXAMPLES[video.layout]}."
        )
    have = "; ".join(f"{name} has {len(f)}, {_span(f)}" for name, f in listed.items())
    return DatasetError(
        f"{where} has no frame {frame_number}: {have}. Choose one of these with `--frame`."
    )


def _span(frames: dict[int, Path]) -> str:
    """Range of frames, such as "0 to 145 in steps of 5"."""
    numbers = list(frames)
    steps = {b - a for a, b in pairwise(numbers)}
    if len(numbers) == 1:
        return str(numbers[0])
    even = f" in steps of {steps.pop()}" if len(steps) == 1 else ""
    return f"{numbers[0]} to {numbers[-1]}{even}"
