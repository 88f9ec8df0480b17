"""transforms.json captures: nerfstudio, Instant-NGP and the synthetic NeRF scenes."""

import math
import unicodedata
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ..config import DataConfig
from ..errors import DatasetError, FormatError
from ..io.colmap.folder import is_safe_name
from ..io.colmap.lenses import MODELS_BY_NAME
from ..io.colmap.model import ColmapCamera
from ..io.files import LONGEST_NAME, is_file, read_json
from ..io.images.read_image import IMAGE_ENDINGS, read_info
from ..io.ply.points import read_point_cloud
from ..io.unsupported_formats import describe_unsupported
from ..quoting import first_few, quoted
from ..scene import FARTHEST, PointCloud
from ..transforms import viewmat_from_opengl
from .capture import Capture, View, repeated
from .poses import check_focal, rigid_matrix

FILES = ("transforms.json", "transforms_train.json")
"""File names that identify such a capture."""

# Camera models of the tools, as the COLMAP model whose first parameters they use.
_MODELS = {
    "SIMPLE_PINHOLE": "PINHOLE",
    "PINHOLE": "PINHOLE",
    "PERSPECTIVE": "OPENCV",
    "SIMPLE_RADIAL": "OPENCV",
    "RADIAL": "OPENCV",
    "OPENCV": "OPENCV",
    "OPENCV_FISHEYE": "OPENCV_FISHEYE",
}
_POINT_FILES = ("points3d.ply", "points3D.ply", "sparse_pc.ply", "init.ply")


def find_transforms(source: Path) -> Path | None:
    """The transforms file at or in `source`, or None."""
    if source.is_file() and source.suffix.lower() == ".json":
        return source
    return next((source / name for name in FILES if (source / name).is_file()), None)


def read_transforms(config: DataConfig, *, photos_required: bool = True) -> Capture:
    """Read the transforms file at or in `config.source`.

    Poses are camera to world in OpenGL axes. The world is kept as in the file; nerfstudio's
    `applied_transform` is already part of its poses and points. Paths are relative to the file;
    `config.images` is not used. A transforms_test.json next to transforms_train.json has the test
    views. Without `photos_required` views without a photo stay, with the path where it should be.

    Raises:
        DatasetError: photos are missing.
        FormatError: the file is not JSON, a key is missing or unusable, a camera model is unknown.
    """
    path = find_transforms(config.source)
    if path is None:
        raise DatasetError(f"There is no {' or '.join(FILES)} in {config.source}.")
    root = path.parent
    data = load_transforms(path)
    views, missing = views_of_file(path, data, photos_required)
    test_names = _stated_test(path, data)
    test = root / "transforms_test.json"
    if path.name == "transforms_train.json" and test.is_file():
        test_views, test_missing = views_of_file(test, load_transforms(test), photos_required)
        test_names = frozenset(view.name for view in test_views)
        views, missing = views + test_views, missing + test_missing
    total = len(views) + (len(missing) if photos_required else 0)
    if not total:
        raise DatasetError(f"{path} lists no frames. Export the capture again.")
    if photos_required and 2 * len(missing) > total:
        raise DatasetError(
            f"{len(missing)} of the {total} images of {path} are missing in {root}: "
            f"{first_few(missing)}. Put them there, or export the capture again."
        )
    warnings = []
    if missing:
        rest = f"; going on with the other {len(views)}" if photos_required else ""
        warnings.append(
            f"{len(missing)} of the {total} images of {path} are missing in {root}: "
            f"{first_few(missing)}{rest}."
        )
    names = [view.name for view in views]
    if twice := repeated(names):
        raise DatasetError(f"{path} lists images twice: {first_few(twice)}. Export it again.")
    return Capture(
        root=root,
        views=views,
        points=_points(path, data),
        test_names=test_names,
        warnings=tuple(warnings),
    )


def load_transforms(path: Path) -> dict[str, Any]:
    """Content of a transforms.json, at least an object with a list `frames`.

    Raises:
        DatasetError: the file is missing.
        FormatError: it is another file.
    """
    data = read_json(path)
    if not isinstance(data, dict) or not isinstance(data.get("frames"), list):
        raise FormatError(
            describe_unsupported(path)
            or f"{path} is not a transforms.json: it must be an object with a list `frames`. "
            "Export it again, or give the folder of the capture."
        )
    return data


def views_of_file(
    path: Path,
    data: dict[str, Any],
    photos_required: bool,
    find: Callable[[Path, str], Path | None] | None = None,
) -> tuple[list[View], list[str]]:
    """Views of one file, and the names of missing photos.

    Args:
        path: The file; names are relative to its folder.
        data: Its content.
        photos_required: Leave out views without a photo.
        find: Returns the photo of a name in that folder; None: tries the usual endings.

    Raises:
        FormatError: a key is missing or unusable, a camera model is unknown.
    """
    find = find or _find
    views, missing = [], []
    for i, frame in enumerate(data["frames"]):
        where = f"{path}: frame {i}"
        if not isinstance(frame, dict):
            raise FormatError(f"{where} is not an object. Export it again.")
        name = inside(where, "file_path", frame.get("file_path"))
        image = find(path.parent, name)
        if image is None:
            missing.append(name)
            if photos_required:
                continue
            image = path.parent / name
        mask = frame.get("mask_path")
        views.append(
            View(
                name=image.relative_to(path.parent).as_posix(),
                image=image,
                viewmat=viewmat_from_opengl(
                    rigid_matrix(where, "transform_matrix", frame.get("transform_matrix"))
                ),
                camera=_camera(where, data | frame, image),
                mask=_mask(path.parent, inside(where, "mask_path", mask)) if mask else None,
            )
        )
    return views, missing


def _stated_test(path: Path, data: dict[str, Any]) -> frozenset[str]:
    """Names of test views in nerfstudio's `test_filenames`."""
    stated = data.get("test_filenames", [])
    if not isinstance(stated, list):
        raise FormatError(f"{path}: test_filenames must be a list. Export the capture again.")
    return frozenset(inside(str(path), "test_filenames", name) for name in stated)


def inside(where: str, key: str, value: Any) -> str:
    """Return `value` as a relative path inside the folder of the file; raise FormatError for
    others."""
    if not isinstance(value, str) or not is_safe_name(value):
        raise FormatError(
            f"{where}: {key} is {quoted(value)}, expected a path inside the folder of the file, "
            f"without '..', not absolute and with names of {LONGEST_NAME} bytes at most. Move the "
            f"photos below it and export it again."
        )
    return PurePosixPath(value.replace("\\", "/")).as_posix()


def _find(root: Path, name: str) -> Path | None:
    """Path of the photo; synthetic NeRF scenes omit the ending."""
    forms = dict.fromkeys((name, *(unicodedata.normalize(form, name) for form in ("NFC", "NFD"))))
    candidates = [form + ending for form in forms for ending in ("", *IMAGE_ENDINGS)]
    return next((root / c for c in candidates if is_file(root / c)), None)


def _mask(root: Path, name: str) -> Path:
    return _find(root, name) or root / name


def _camera(where: str, data: dict[str, Any], image: Path) -> ColmapCamera:
    """Intrinsics of one frame; its own keys take precedence over those of the file."""

    def number(key: str, default: float | None = None) -> float:
        value = data.get(key, default)
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not abs(value) <= FARTHEST  # also refuses NaN
        ):
            raise FormatError(
                f"{where}: {key} is {quoted(value)}, expected a number up to {FARTHEST:g}. "
                f"Export the capture again."
            )
        return float(value)

    if "w" in data and "h" in data:
        width, height = int(number("w")), int(number("h"))
    else:
        info = read_info(image)
        width, height = info.width, info.height
    fisheye = data.get("is_fisheye") is True  # Instant-NGP's spelling
    stated = data.get("camera_model", "OPENCV_FISHEYE" if fisheye else "OPENCV")
    model = _MODELS.get(stated) if isinstance(stated, str) else None
    if model is None:
        raise FormatError(
            f"{where}: unknown camera_model {quoted(stated)}, known are {', '.join(_MODELS)}. "
            f"Undistort the capture, or use its COLMAP model."
        )
    if "fl_x" in data or "camera_angle_x" in data:
        fx = number("fl_x") if "fl_x" in data else _focal(width, number("camera_angle_x"))
    else:
        raise FormatError(f"{where}: neither fl_x nor camera_angle_x is given. Export it again.")
    if "fl_y" in data:
        fy = number("fl_y")
    elif "camera_angle_y" in data and "fl_x" not in data:
        fy = _focal(height, number("camera_angle_y"))
    else:
        fy = fx
    if not (0 < width < 2**31 and 0 < height < 2**31):
        raise FormatError(
            f"{where}: the size {width} x {height} must be positive, and sides below 2^31 pixels. "
            f"Export the capture again."
        )
    check_focal(where, (fx, fy), width, height)
    values = {
        "fx": fx,
        "fy": fy,
        "cx": number("cx", width / 2),
        "cy": number("cy", height / 2),
    }
    if model == "OPENCV" and number("k4", 0) != 0:
        raise FormatError(
            f"{where}: k4 of a {stated} camera has no agreed meaning, expected 0 or none. "
            f"Undistort the capture, or use its COLMAP model."
        )
    if model == "OPENCV" and number("k3", 0) != 0:
        model = "FULL_OPENCV"
        values |= dict.fromkeys(("k4", "k5", "k6"), 0.0)
    names = MODELS_BY_NAME[model].params
    params = [values[name] if name in values else number(name, 0) for name in names]
    return ColmapCamera(model=model, width=width, height=height, params=np.array(params))


def _focal(size: int, angle: float) -> float:
    """Focal length in pixels from a full field of view in radians; NaN if invalid."""
    return 0.5 * size / math.tan(0.5 * angle) if 0 < angle < math.pi else math.nan


def _points(path: Path, data: dict[str, Any]) -> PointCloud:
    stated = data.get("ply_file_path")
    if stated is not None:
        return read_point_cloud(path.parent / inside(str(path), "ply_file_path", stated))
    file = next((path.parent / n for n in _POINT_FILES if is_file(path.parent / n)), None)
    if file is not None:
        return read_point_cloud(file)
    return PointCloud.none()
