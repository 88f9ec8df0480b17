"""Inspection of a capture: the checks of a training, run before it, and advice."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ..config import DataConfig
from ..datasets import Capture, Folder, View, read_capture
from ..datasets.masks import check_mask_size, masks_of_views
from ..datasets.photo_headers import PhotoFit, check_fit, fit_photos, photo_warnings
from ..datasets.points import point_warnings
from ..datasets.poses import axis_warnings, position_warnings
from ..datasets.programs import find_program
from ..datasets.resolution import check_resolution
from ..datasets.split import split_views, split_warnings
from ..datasets.transforms_json import find_transforms
from ..depth.params import DEPTH_FOLDER
from ..depth.stated import StatedDepth, stated_depth
from ..errors import BackendError, DatasetError, GsError
from ..io.colmap.folder import find_model
from ..io.colmap.lenses import NO_PINHOLE
from ..io.images.image_header import ImageInfo
from ..io.images.read_image import decoding_pixels, read_info
from ..scene import Cameras, PointCloud, Scene, within_reach
from ..sfm.output_path import has_no_cameras
from ..text_format import count_text
from ..video import is_video
from .capture_facts import CaptureFacts, Problem, photo_folder_facts

FEW_PHOTOS = 15
"""Number of photos below which a model is rarely good from all sides."""
FEW_POINTS = 200
"""Number of points below which the initial shape is poorly defined."""
SQUARE = 1e-3
"""Relative difference of focal lengths above which pixels are not square."""
PHOTO_FOLDERS = ("images", "input", "photos", "rgb", "images_2", "images_4", "images_8")
"""Folders to search if the given one does not contain the photos."""


def inspect(config: DataConfig, *, depths: str = DEPTH_FOLDER) -> CaptureFacts:
    """Inspect a capture; errors are returned as facts, never raised.

    Reads the model and the headers of photos and masks, without decoding them: about a second for
    1000 photos. Errors and warnings have the wording of the training; those that need decoded
    photos are missing.

    Args:
        config: The capture and its options.
        depths: Folder of the depth maps.
    """
    try:
        check_resolution(config.resolution)
        if has_no_cameras(config.source):
            return photo_folder_facts(config.source)
        capture = read_capture(config, photos_required=False)
    except (GsError, OSError) as error:
        return CaptureFacts(
            source=config.source, problems=(_error(_what_else(config.source, error)),)
        )
    seen = _Seen.of(capture)
    problems = [
        *_capture_problems(config, capture, seen),
        *_photo_problems(seen),
        *_use_problems(config, capture, seen),
    ]
    files, mask_problems = _masks(config, capture, seen)
    stated = stated_depth(capture.root, [view.name for view in seen.views], folder=depths)
    problems += [*mask_problems, *_depth_problems(stated)]
    return _facts(config, capture, seen, files, stated, problems)


@dataclass(frozen=True, kw_only=True)
class _Seen:
    """The existing photos of a capture by name, with their headers."""

    views: list[View]
    missing: tuple[str, ...]
    infos: list[ImageInfo | None]
    """Headers of the photos; None: unreadable, or unsupported on this machine."""
    errors: tuple[str, ...]
    """Messages on unreadable photos."""
    unknown: tuple[str, ...]
    """Photos whose headers need a package that is not installed."""

    @classmethod
    def of(cls, capture: Capture) -> "_Seen":
        """Find the photos of `capture` and read their headers."""
        views = sorted(capture.views, key=lambda view: view.name)
        there = [view for view in views if view.image.is_file()]
        infos, errors, unknown = [], [], []
        for view in there:
            info = None
            try:
                info = read_info(view.image)
            except BackendError:
                unknown.append(view.name)
            except GsError as error:
                errors.append(str(error))
            infos.append(info)
        return cls(
            views=there,
            missing=tuple(view.name for view in views if not view.image.is_file()),
            infos=infos,
            errors=tuple(errors),
            unknown=tuple(unknown),
        )

    @cached_property
    def known(self) -> tuple[list[View], list[ImageInfo]]:
        """Views and headers of the photos whose header was read."""
        pairs = [(v, i) for v, i in zip(self.views, self.infos, strict=True) if i is not None]
        return [view for view, _ in pairs], [info for _, info in pairs]

    @cached_property
    def fit(self) -> PhotoFit:
        """Fit of these photos to their cameras."""
        return fit_photos(*self.known)


def _capture_problems(config: DataConfig, capture: Capture, seen: _Seen) -> Iterator[Problem]:
    """Problems that reading by a training would report, with the folder of missing photos."""
    warnings = capture.warnings
    if seen.missing:
        try:
            warnings = read_capture(config).warnings
        except (GsError, OSError) as error:
            place = _photos_elsewhere(capture, config.images)
            yield _error(f"{error} They are in {place}." if place else str(error))
            warnings = ()
    yield from map(_note, warnings)
    if 0 < len(seen.views) < FEW_PHOTOS:
        count = count_text(len(seen.views), "photo")
        yield _note(f"Only {count}; views between them will be poor.")


def _photos_elsewhere(capture: Capture, images: str) -> str | None:
    for name in PHOTO_FOLDERS:
        if name == images or not (capture.root / name).is_dir():
            continue
        folder = Folder(capture.root / name)
        if all(folder.find_image(view.name) for view in capture.views[:5]):
            return name
    return None


def _photo_problems(seen: _Seen) -> Iterator[Problem]:
    if seen.errors:
        first, *others = seen.errors
        rest = f" {count_text(len(others), 'other photo')} cannot be read either."
        yield _error(first + rest if others else first)
    if seen.unknown:
        yield _note(
            f"{count_text(len(seen.unknown), 'photo')} cannot be checked here, such as "
            f"{seen.unknown[0]}; the training checks them."
        )
    views, infos = seen.known
    found = seen.fit
    try:
        check_fit(views, infos, found)
    except DatasetError as error:
        yield _error(str(error))
    yield from map(_note, photo_warnings(views, infos, found))


def _use_problems(config: DataConfig, capture: Capture, seen: _Seen) -> Iterator[Problem]:
    """Problems of cameras, points and the split."""
    if seen.views:
        try:
            names = [view.name for view in seen.views]
            _, test = split_views(names, config, stated=capture.test_names)
            yield from map(_note, split_warnings(len(names), test, config))
        except GsError as error:
            yield _error(str(error))
    usable = within_reach(capture.points.points)
    yield from map(_note, point_warnings(capture.points, usable))
    count = int(usable.sum())
    if 0 < count < FEW_POINTS:
        yield _note(f"Only {count} SfM points; run COLMAP's triangulation for a better start.")
    pinholes = [view for view in seen.views if view.camera.model not in NO_PINHOLE]
    if pinholes:
        scene = _scene(pinholes, capture.points, usable)
        yield from map(_note, (*position_warnings(scene), *axis_warnings(scene)))


def _scene(views: Sequence[View], points: PointCloud, usable: np.ndarray) -> Scene:
    """Cameras before undistortion and scaling, and the usable points."""
    cameras = Cameras(
        viewmats=np.stack([view.viewmat for view in views]),
        Ks=np.stack([view.camera.K for view in views]),
        widths=np.array([view.camera.width for view in views], np.int64),
        heights=np.array([view.camera.height for view in views], np.int64),
        names=tuple(view.name for view in views),
    )
    kept = PointCloud(points=points.points[usable], colors=points.colors[usable])
    return Scene(cameras=cameras, points=kept)


def _masks(
    config: DataConfig, capture: Capture, seen: _Seen
) -> tuple[list[Path | None], list[Problem]]:
    """The mask file of each photo, and problems of masks."""
    none: list[Path | None] = [None] * len(seen.views)
    if config.mask_mode == "none" or not seen.views:
        return none, []
    try:
        files, warnings = masks_of_views(config, capture.root, seen.views)
    except GsError as error:
        return none, [_error(str(error))]
    file_of = dict(zip((view.name for view in seen.views), files, strict=True))
    try:
        for view, size in zip(seen.known[0], seen.fit.sizes, strict=True):
            file = file_of[view.name]
            if file is not None:
                check_mask_size(view, file, size)
    except BackendError:  # a format whose package is not installed
        return files, [*map(_note, warnings)]
    except GsError as error:
        return files, [_error(str(error)), *map(_note, warnings)]
    return files, [*map(_note, warnings)]


def _depth_problems(stated: StatedDepth) -> list[Problem]:
    if stated.problem:
        return [_note(stated.problem)]
    views = len(stated.table)
    maps = sum(1 for row in stated.table if row["map"] is not None)
    if maps == 0:
        return []
    if not stated.entries:
        text = (
            f"There is no {stated.params.name} for the depth maps; the training estimates their "
            f"scales, and a check of the maps shows them."
        )
        return [_note(text)]
    short = views - min(stated.entries, maps)
    return (
        [_note(f"{short} of {count_text(views, 'photo')} lack a depth map or its scale.")]
        if short
        else []
    )


def _facts(
    config: DataConfig,
    capture: Capture,
    seen: _Seen,
    masks: list[Path | None],
    stated: StatedDepth,
    problems: list[Problem],
) -> CaptureFacts:
    source, views = config.source, capture.views
    model = colmap_of(source) if source.is_dir() else None
    folder = Folder(capture.root / config.images) if model else None
    transforms = find_transforms(source) if model is None else None
    kind, file = ("COLMAP", model) if model else ("transforms.json", transforms)
    if file is None or source.is_file():
        program = find_program(source, config.images)
        kind, file = (program.program, program.path) if program else (kind, file)
    if file is None:
        kind = "video"
    cameras = {view.camera.model: set() for view in views}
    for view in views:
        camera = view.camera
        cameras[camera.model].add((camera.width, camera.height, camera.params.tobytes()))
    sizes = _sizes(seen)
    aspects = [_aspect(view) for view in views if view.camera.model not in NO_PINHOLE]
    return CaptureFacts(
        source=source,
        kind=kind,
        model=file,
        photos=len(seen.views),
        missing=seen.missing,
        without_camera=max(0, len(folder) - len(seen.views)) if folder else 0,
        points=int(within_reach(capture.points.points).sum()),
        error_px=capture.error_px,
        cameras={name: len(found) for name, found in cameras.items()},
        camera_models=dict(Counter(view.camera.model for view in views)),
        sizes=dict(Counter(sizes)),
        decoding_pixels=sum(
            decoding_pixels(view.image, size) for view, size in zip(seen.views, sizes, strict=True)
        ),
        sideways=sum(seen.fit.upright),
        distorted=dict(Counter(v.camera.model for v in views if not v.camera.is_pinhole)),
        not_square=sum(1 for aspect in aspects if aspect > SQUARE),
        aspect=max(aspects, default=0.0),
        masks=sum(1 for file in masks if file is not None),
        alphas=sum(1 for info in seen.infos if info and info.has_alpha),
        depth=stated,
        problems=tuple(sorted(problems, key=lambda problem: not problem.is_error)),
    )


def _sizes(seen: _Seen) -> list[tuple[int, int]]:
    """Width and height of each photo, px."""
    known = dict(zip((view.name for view in seen.known[0]), seen.fit.sizes, strict=True))
    own = ((view.camera.width, view.camera.height) for view in seen.views)
    return [known.get(v.name, o) for v, o in zip(seen.views, own, strict=True)]


def _aspect(view: View) -> float:
    K = view.camera.K
    return float(abs(K[1, 1] / K[0, 0] - 1))


def _what_else(source: Path, error: Exception) -> str:
    """The error of the reader, with a hint on the content of the folder."""
    try:
        entries = list(source.iterdir()) if source.is_dir() else []
    except OSError:
        entries = []
    if source.is_dir() and not entries:
        return f"{source} is empty. Choose the folder with `sparse` and the photos."
    if any(entry.suffix.lower() == ".db" for entry in entries):
        return f"{error} There is a COLMAP database; its mapper has not been run yet."
    return str(error)


def _error(text: str) -> Problem:
    return Problem(is_error=True, text=text)


def _note(text: str) -> Problem:
    return Problem(is_error=False, text=text)


def find_capture(path: str | Path) -> Path:
    """The folder of the capture of a picked path.

    Users pick `sparse/0`, `sparse`, the photos or a file of the model; trainers need the folder
    above. The path of a capture, and one without a capture, is returned unchanged.
    """
    path = Path(path)
    if path.suffix.lower() == ".json" or is_video(path):
        return path
    folder = path.parent if path.is_file() else path
    if folder.name.isdigit() and folder.parent.name == "sparse":
        return folder.parent.parent
    if folder.name == "sparse":
        return folder.parent
    if not _has_capture(folder) and _has_capture(folder.parent):  # which may be a whole disk
        return folder.parent
    return folder


def colmap_of(folder: Path) -> Path | None:
    """The folder of the COLMAP model of a capture; None if there is none."""
    try:
        return find_model(folder)[0]
    except (DatasetError, OSError):
        return None


def _has_capture(folder: Path) -> bool:
    found = colmap_of(folder) or find_transforms(folder) or find_program(folder, below=False)
    return found is not None
