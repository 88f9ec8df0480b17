"""JSON layouts of multi-view video frames: NeuS2 and Instant-NGP."""

from pathlib import Path, PurePosixPath
from typing import Any

from ...config import DataConfig
from ...errors import DatasetError, FormatError
from ...quoting import first_few, quoted
from ...scene import PointCloud
from ...text_format import number
from ...transforms import invert_rigid, viewmat_from_opengl
from ..capture import Capture, View
from ..poses import pinhole_camera, rigid_matrix
from ..transforms_json import inside, load_transforms, views_of_file
from .photos import PLAIN_FOLDERS

_NGP = ("transform", "transforms")


def read_neus2(
    config: DataConfig, case: Path, path: Path, frame: int, photos_required: bool
) -> Capture:
    """`data_NeuS2`: `transform_<frame>.json`, also in `train` and `test` for the split.

    The world is that of the file: the people are in the unit sphere. Views that are listed twice,
    as the data set's own script does with test views, are read once.

    Raises:
        DatasetError: photos are missing.
        FormatError: the file is not JSON, or a key is missing or unusable.
    """
    root = path.parent.parent if path.parent.name in ("train", "test") else path.parent
    files = [root / place / path.name for place in ("", "train", "test")]
    files = [file for file in files if file.is_file()]
    views: dict[str, View] = {}
    test: set[str] = set()
    missing: set[str] = set()
    for file in files:
        data = load_transforms(file)
        for i, entry in enumerate(data["frames"]):
            view = _neus2_view(f"{file}: frame {i}", root, data, entry)
            views[view.name] = view
            if file.parent.name == "test":
                test.add(view.name)
            if not view.image.is_file():
                missing.add(view.name)
    return _capture(root, path, views, test, missing, photos_required)


def read_ngp(
    config: DataConfig, case: Path, path: Path, frame: int, photos_required: bool
) -> Capture:
    """`data_ngp/<frame>`: `transform_{train,test,val}.json`, with or without an s.

    The world is that of the files: upright, with the cameras 4 units from the middle on average.

    Raises:
        DatasetError: a file or photos are missing.
        FormatError: a file is not JSON, a key is missing or unusable, a camera model is unknown.
    """
    views: dict[str, View] = {}
    test: set[str] = set()
    missing: set[str] = set()
    found = False
    for split in ("train", "test", "val", ""):
        file = _first(path / f"{stem}{f'_{split}' if split else ''}.json" for stem in _NGP)
        if file is None:
            continue
        found = True
        listed, lost = views_of_file(file, load_transforms(file), photos_required, _either_folder)
        views |= {view.name: view for view in listed}
        missing |= set(lost)
        if split in ("test", "val"):
            test |= {view.name for view in listed}
    if not found:
        raise DatasetError(
            f"{path} has no transform_train.json (nor transforms_train.json or transform.json). "
            f"Copy the frame again, or choose another one with `--frame`."
        )
    return _capture(path, path, views, test, missing - views.keys(), photos_required)


def _capture(
    root: Path,
    file: Path,
    views: dict[str, View],
    test: set[str],
    missing: set[str],
    photos_required: bool,
) -> Capture:
    total = len(views.keys() | missing)
    if not total:
        raise DatasetError(f"{file} lists no views. Export it again.")
    if photos_required and 2 * len(missing) > total:
        raise DatasetError(
            f"{len(missing)} of the {number(total)} photos of {file} are missing in {root}: "
            f"{first_few(sorted(missing))}. Put them there, or choose another frame."
        )
    warnings = []
    if missing:
        rest = f"; going on with the other {total - len(missing)}" if photos_required else ""
        warnings.append(
            f"{len(missing)} of the {number(total)} photos of {file} are missing in {root}: "
            f"{first_few(sorted(missing))}{rest}."
        )
    kept = [v for name, v in views.items() if not (photos_required and name in missing)]
    return Capture(
        root=root,
        views=kept,
        points=PointCloud.none(),
        test_names=frozenset(test),
        warnings=tuple(warnings),
    )


def _neus2_view(where: str, root: Path, data: dict[str, Any], entry: Any) -> View:
    if not isinstance(entry, dict):
        raise FormatError(f"{where} is not an object. Export it again.")
    name = inside(where, "file_path", entry.get("file_path"))
    pose = rigid_matrix(where, "transform_matrix", entry.get("transform_matrix"))
    merged = data | entry
    width, height = _pixels(where, merged, "w"), _pixels(where, merged, "h")
    # `from_na`: poses have OpenCV's axes, as in NeuS, not OpenGL's.
    viewmat = invert_rigid(pose) if merged.get("from_na") is True else viewmat_from_opengl(pose)
    matrix = merged.get("intrinsic_matrix")
    return View(
        name=name,
        image=_either_folder(root, name) or root / name,
        viewmat=viewmat,
        camera=pinhole_camera(where, "intrinsic_matrix", matrix, width, height),
    )


def _pixels(where: str, data: dict[str, Any], key: str) -> int:
    value = data.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 1 <= value < 2**31:
        raise FormatError(f"{where}: {key} is {quoted(value)}, expected pixels. Export it again.")
    return int(value)


def _either_folder(root: Path, name: str) -> Path | None:
    """The photo at the stated path, or in a folder of another usual name."""
    path = PurePosixPath(name)
    candidates = [root / path]
    for folder in PLAIN_FOLDERS:
        candidates += [root / folder / path.name, root / path.parent / folder / path.name]
    return _first(candidate for candidate in candidates if candidate.is_file())


def _first(paths: Any) -> Path | None:
    return next((path for path in paths if path.is_file()), None)
