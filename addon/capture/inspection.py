"""What a capture's folder holds, and what is wrong with it before any training; without bpy."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..core import (
    Capture,
    DataConfig,
    DatasetError,
    Folder,
    GsError,
    ImageInfo,
    StatedDepth,
    View,
    find_colmap,
    read_capture,
    read_header,
    stated_depth,
)
from .depth_maps import MISSING, DepthReport, from_table

FEW_PHOTOS = 15
"""Fewer photos than this seldom give a model that can be looked at from all sides."""
FEW_POINTS = 200
"""Fewer points than this leave the shape to chance."""
NO_PINHOLE = frozenset({"EQUIRECTANGULAR"})
"""Camera models without focal length and principal point."""
DEPTHS = "depths"
"""Folder of the depth maps in a capture."""
PHOTO_FOLDERS = ("images", "input", "photos", "rgb", "images_2", "images_4", "images_8")
"""Folders looked into when the one that was named does not hold the photos."""


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Something to mend, or to know, before training."""

    is_error: bool
    """Training cannot start."""
    text: str
    """What, where and what to do."""


@dataclass(frozen=True, kw_only=True)
class CaptureFacts:
    """What was found."""

    source: Path
    """The folder (or transforms file) to train on."""
    kind: str = ""
    """`COLMAP` or `transforms.json`; empty: no capture."""
    model: Path | None = None
    """Folder of the COLMAP model, or the transforms file."""
    photos: int = 0
    """Photos that are there."""
    missing: tuple[str, ...] = ()
    """Names of photos that are not."""
    without_camera: int = 0
    """Photos in the folder that the model has no camera for."""
    points: int = 0
    """SfM points."""
    camera_models: dict[str, int] = field(default_factory=dict)
    """Number of views by COLMAP's name of the camera model."""
    sizes: dict[tuple[int, int], int] = field(default_factory=dict)
    """Number of views by width and height of their camera, pixels."""
    masks: int = 0
    """Photos with a mask file."""
    alphas: int = 0
    """Photos with transparency."""
    depths: int = 0
    """Photos with a depth map."""
    depth_params: int = 0
    """Photos with an entry in depth_params.json."""
    depth_report: DepthReport = field(default=DepthReport(()))
    """What is known of the depth maps without reading them."""
    problems: tuple[Problem, ...] = ()
    """Errors first."""

    @property
    def can_train(self) -> bool:
        """Whether nothing stands in the way."""
        return bool(self.kind) and not any(problem.is_error for problem in self.problems)

    def lines(self) -> list[tuple[str, str]]:
        """Label and value of each finding, for a panel."""
        if not self.kind:
            return []
        sizes = [f"{w} x {h} px" for w, h in self.sizes]
        lines = [
            (self.kind, str(self.model)),
            ("Photos", f"{self.photos} of {self.photos + len(self.missing)}"),
            ("Size", sizes[0] if len(sizes) == 1 else f"{len(sizes)} different"),
            ("Cameras", ", ".join(f"{n} {name}" for name, n in self.camera_models.items())),
            ("Points", f"{self.points:,}"),
        ]
        masks = f"{self.masks} files" if self.masks else f"{self.alphas} photos with alpha"
        if self.masks or self.alphas:
            lines.append(("Masks", masks))
        if self.depths or self.depth_params:
            lines.append(("Depths", f"{self.depths} maps, {self.depth_params} scales"))
        return lines


def find_capture(path: str | Path) -> Path:
    """The folder of the capture that a user means who picks `path`.

    People pick `sparse/0`, `sparse`, the photos or a file of the model; trainers want the folder
    above. What already is a capture, and what is none, stays.
    """
    path = Path(path)
    if path.suffix.lower() == ".json":
        return path
    folder = path.parent if path.is_file() else path
    if folder.name.isdigit() and folder.parent.name == "sparse":
        return folder.parent.parent
    if folder.name == "sparse":
        return folder.parent
    if not _has_capture(folder) and _has_capture(folder.parent):
        return folder.parent
    return folder


def inspect(
    path: str | Path, *, images: str = "images", masks: str = "", depths: str = DEPTHS
) -> CaptureFacts:
    """Look into a capture; never raises on a bad one, the facts say what is wrong.

    Reads the model and the headers of all photos, decodes none: about a second for 1000 photos.

    Args:
        path: What the user picked.
        images: Folder of the photos in a COLMAP capture.
        masks: Folder of the masks; empty: `masks` if it is there.
        depths: Folder of the depth maps.
    """
    if not str(path):
        return CaptureFacts(source=Path(), problems=(_error("Choose the folder of a capture."),))
    source = find_capture(path)
    try:
        capture = read_capture(DataConfig(source=source, images=images), photos_required=False)
    except (GsError, OSError) as error:
        return CaptureFacts(source=source, problems=(_error(_what_else(source, error)),))
    return _facts(source, capture, images, masks, depths)


def _facts(source: Path, capture: Capture, images: str, masks: str, depths: str) -> CaptureFacts:
    there = [view for view in capture.views if view.image.is_file()]
    missing = tuple(view.name for view in capture.views if not view.image.is_file())
    infos = {view.name: read_header(view.image) for view in there}
    is_colmap = source.is_dir() and _is_colmap(source)
    folder = Folder(capture.root / images) if is_colmap else None
    mask_files = _matching(capture.root / (masks or "masks"), there)
    stated = stated_depth(capture.root, [view.name for view in there], folder=depths)
    maps = from_table(stated.table)
    model = find_colmap(source)[0] if is_colmap else _transforms_file(source)
    problems = [
        *_photo_problems(source, capture, missing, images),
        *_size_problems(there, infos),
        *_camera_problems(capture.views),
        *_point_problems(capture),
        *_mask_problems(there, mask_files, infos, masks),
        *_depth_problems(stated, maps),
    ]
    return CaptureFacts(
        source=source,
        kind="COLMAP" if is_colmap else "transforms.json",
        model=model,
        photos=len(there),
        missing=missing,
        without_camera=max(0, len(folder) - len(there)) if folder else 0,
        points=len(capture.points),
        camera_models=dict(Counter(view.camera.model for view in capture.views)),
        sizes=dict(Counter((v.camera.width, v.camera.height) for v in capture.views)),
        masks=len(mask_files),
        alphas=sum(1 for info in infos.values() if info and info.has_alpha),
        depths=len(maps.rows) - maps.counts[MISSING],
        depth_params=stated.entries,
        depth_report=maps,
        problems=tuple(sorted(problems, key=lambda problem: not problem.is_error)),
    )


def _photo_problems(
    source: Path, capture: Capture, missing: tuple[str, ...], images: str
) -> list[Problem]:
    total = len(capture.views)
    notes = [_note(text) for text in capture.warnings if "missing" not in text]
    if 2 * len(missing) > total:
        place = _photos_elsewhere(source, capture, images)
        advice = (
            f"They are in {place}: set the photo folder to it."
            if place
            else "Put the photos that COLMAP was run on there, or name their folder."
        )
        text = f"{len(missing)} of {total} photos are missing, such as {missing[0]}. {advice}"
        return [_error(text), *notes]
    if missing:
        some = f"{len(missing)} of {total} photos are missing, such as {missing[0]}"
        notes.append(_note(f"{some}; training leaves them out."))
    if total - len(missing) < FEW_PHOTOS:
        notes.append(
            _note(f"Only {total - len(missing)} photos; views between them will look rough.")
        )
    return notes


def _photos_elsewhere(source: Path, capture: Capture, images: str) -> str | None:
    for name in PHOTO_FOLDERS:
        if name == images or not (source / name).is_dir():
            continue
        folder = Folder(source / name)
        if all(folder.find_image(view.name) for view in capture.views[:5]):
            return name
    return None


def _size_problems(views: list[View], infos: dict[str, ImageInfo | None]) -> list[Problem]:
    wrong, sideways, damaged = [], [], []
    for view in views:
        info = infos[view.name]
        if info is None:
            if view.image.suffix.lower() in (".png", ".jpg", ".jpeg"):
                damaged.append(view)
        elif view.fits(info.width, info.height):
            continue
        elif info.is_sideways and view.fits(info.height, info.width):
            sideways.append(view)
        else:
            wrong.append(view)
    out = []
    if damaged:
        text = f"{len(damaged)} photos look damaged, such as {damaged[0].image}. Copy them again."
        out.append(_note(text))
    if wrong:
        view, info = wrong[0], infos[wrong[0].name]
        out.append(
            _error(
                f"{len(wrong)} photos do not fit their cameras, such as {view.name} with "
                f"{info.width} x {info.height} pixels for {view.camera.width} x "
                f"{view.camera.height}. Use the photos that COLMAP was run on, uncropped."
            )
        )
    if sideways:
        out.append(
            _note(
                f"{len(sideways)} photos are stored sideways and turned by EXIF. Training turns "
                f"them; Blender's camera backgrounds do not."
            )
        )
    return out


def _camera_problems(views: list[View]) -> list[Problem]:
    out = []
    distorted = Counter(view.camera.model for view in views if not view.camera.is_pinhole)
    if distorted:
        kinds = ", ".join(f"{n} {name}" for name, n in distorted.items())
        out.append(
            _note(
                f"The photos have lens distortion ({kinds}). Training removes it; Blender's "
                f"cameras have the undistorted lens, so background photos fit only near the middle."
            )
        )
    odd = [view for view in views if view.camera.model not in NO_PINHOLE and _aspect(view) > 1e-3]
    if odd:
        out.append(
            _note(
                f"{len(odd)} cameras have pixels that are not square (fx and fy differ by up to "
                f"{max(map(_aspect, odd)):.1%}). Blender keeps pixel aspect per scene; choosing a "
                f"camera with the add-on sets it."
            )
        )
    return out


def _aspect(view: View) -> float:
    K = view.camera.K
    return abs(K[1, 1] / K[0, 0] - 1)


def _point_problems(capture: Capture) -> list[Problem]:
    points = capture.points
    count = int(np.isfinite(points.points).all(axis=1).sum())
    if count == 0:
        return [_note("There are no SfM points; training starts from random ones, which is worse.")]
    if count < FEW_POINTS:
        return [_note(f"Only {count} SfM points; run COLMAP's triangulation for a better start.")]
    if not points.colors.any():
        return [_note("All SfM points are black; training takes their colors from the photos.")]
    return []


def _mask_problems(
    views: list[View],
    files: dict[str, Path],
    infos: dict[str, ImageInfo | None],
    asked: str,
) -> list[Problem]:
    if not files:
        if asked:
            return [_error(f"The mask folder {asked} has no mask of any photo. Name another one.")]
        return []
    out = []
    for view in views:
        own, mask = infos[view.name], files.get(view.name) and read_header(files[view.name])
        if own and mask and not _same_size(own, mask):
            out.append(
                _error(
                    f"Mask {files[view.name]} is {mask.width} x {mask.height} pixels, its photo "
                    f"{own.width} x {own.height}. Scale the masks to the size of the photos."
                )
            )
            break
    if len(files) < len(views):
        out.append(_note(f"{len(views) - len(files)} of {len(views)} photos have no mask."))
    return out


def _same_size(photo: ImageInfo, mask: ImageInfo) -> bool:
    sizes = [(photo.width, photo.height)]
    if photo.is_sideways:
        sizes.append((photo.height, photo.width))
    return (mask.width, mask.height) in sizes


def _depth_problems(stated: StatedDepth, maps: DepthReport) -> list[Problem]:
    if stated.problem:
        return [_note(stated.problem)]
    views, missing = len(maps.rows), maps.counts[MISSING]
    if missing == views:
        return []
    if not stated.entries:
        text = (
            f"There is no {stated.params.name} for the depth maps; training finds their scales "
            f"itself. Check Maps in the Depth panel shows them."
        )
        return [_note(text)]
    short = views - min(stated.entries, views - missing)
    return [_note(f"{short} of {views} photos lack a depth map or its scale.")] if short else []


def _matching(root: Path, views: list[View]) -> dict[str, Path]:
    """The file of a folder for each view that has one, by the view's name."""
    if not root.is_dir():
        return {}
    folder = Folder(root)
    found = {view.name: folder.find_mask(view.name) for view in views}
    return {name: file for name, file in found.items() if file is not None}


def _what_else(source: Path, error: Exception) -> str:
    """The reader's sentence, with what the folder seems to be instead."""
    try:
        entries = list(source.iterdir()) if source.is_dir() else []
    except OSError:
        entries = []
    if source.is_dir() and not entries:
        return f"{source} is empty. Choose the folder that holds `sparse` and the photos."
    if any(entry.suffix.lower() == ".db" for entry in entries):
        return f"{error} There is a COLMAP database; its mapper has not been run yet."
    return str(error)


def _has_capture(folder: Path) -> bool:
    return _is_colmap(folder) or _transforms_file(folder) is not None


def _is_colmap(folder: Path) -> bool:
    try:
        find_colmap(folder)
    except (DatasetError, OSError):
        return False
    return True


def _transforms_file(source: Path) -> Path | None:
    if source.is_file():
        return source
    names = ("transforms.json", "transforms_train.json")
    return next((source / name for name in names if (source / name).is_file()), None)


def _error(text: str) -> Problem:
    return Problem(is_error=True, text=text)


def _note(text: str) -> Problem:
    return Problem(is_error=False, text=text)
