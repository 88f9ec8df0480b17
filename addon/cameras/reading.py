"""Capture reading for an import, in any thread; reads no bpy data."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..capture.folders import same_folder
from ..core import (
    NO_PINHOLE,
    ColmapCamera,
    DataConfig,
    GsError,
    Undistortion,
    View,
    find_capture,
    plan_undistortion,
    read_capture,
    up_from_exif,
)
from ..interface.option_labels import error_text, panel_text
from ..process.incremental_tasks import Check
from . import alignment, sfm_points
from . import objects as co
from .backgrounds import Photo, photo_on_disk
from .capture_transform import Drawing, drawing_of
from .undistort_program import task_of

FAR = 1e4
"""Distance of a capture from its origin, in extents, at which single precision becomes visible."""


@dataclass(frozen=True, kw_only=True)
class ReadCamera:
    """A camera to create."""

    name: str
    """Name of the object."""
    setup: co.Setup
    photo: Photo | None
    """Photo; None: not requested."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ReadPoints:
    """The SfM points."""

    count: int
    columns: tuple[tuple[str, str, np.ndarray], ...]
    """Attributes of the points, from `sfm_points.columns`."""
    radius: float
    """Display radius, from `sfm_points.display`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ReadCapture:
    """Contents of a read capture."""

    source: Path
    """Folder or file of the capture, absolute."""
    images: str
    """Folder of the photos."""
    up: np.ndarray | None
    """[3] up direction from its files, or from the EXIF orientation of photos; None: unknown."""
    photo_up: np.ndarray | None
    """[3] up direction from the EXIF orientation of photos; None: unknown."""
    origin: np.ndarray | None
    """[3] local origin of its world; None: there is none."""
    matrix: np.ndarray
    """[4, 4] alignment."""
    cameras: tuple[ReadCamera, ...]
    """Cameras, sorted by image name."""
    points: ReadPoints | None
    """SfM points; None: there are none, or they were not requested."""
    drawing: Drawing
    copies: tuple[dict[str, Any], ...]
    """Undistortion tasks of missing copies."""
    warnings: tuple[str, ...]
    """Sentences for the user."""

    @property
    def name(self) -> str:
        """Name in Blender."""
        source = self.source.parent if self.source.is_file() else self.source
        return source.name or "Capture"


def read(
    path: Path,
    check: Check,
    *,
    images: str,
    photos: bool,
    points: bool,
    align: bool,
    origins: Sequence[tuple[Path | None, np.ndarray]] = (),
) -> ReadCapture:
    """Read a capture.

    Args:
        path: Its folder, or a folder or file inside it.
        check: Raises after cancellation.
        images: As `captures.import_capture`, like the following.
        origins: Local origins of imported captures, zeros for none, with their folders; None: the
            capture to update, in any folder. A capture that is imported again keeps its origin.

    Raises:
        GsError: it cannot be read.
        ValueError: none of its views can be a Blender camera.
    """
    source = find_capture(path).absolute()
    there = (at for folder, at in origins if folder is None or same_folder(folder, source))
    data = DataConfig(source=source, images=images)
    capture = read_capture(data, photos_required=False, origin=next(there, None))
    check()
    views = sorted(capture.views, key=lambda view: view.name)
    usable = [view for view in views if view.camera.model not in NO_PINHOLE]
    if not usable:
        raise ValueError(f"{source} has only panoramas. Cut them into pinhole views with COLMAP.")
    viewmats = np.stack([view.viewmat for view in usable])
    finite = np.isfinite(capture.points.points).all(axis=1)
    cloud = capture.points.points[finite]
    photo_up = up_from_exif(usable)
    up = photo_up if capture.up is None else capture.up
    matrix = alignment.align(viewmats, cloud, up).matrix if align else np.eye(4)
    check()
    lenses, cameras, copies = _Lenses(), [], []
    for view in usable:
        check()
        own = _stated(view, lenses.undistortion(view.camera))
        photo = photo_on_disk(own, Path(view.image)) if photos else None
        copy = None if photo is None or photo.shown == photo.file else photo.shown
        if copy is not None and not copy.is_file():
            copies.append(task_of(own, copy))
        cameras.append(ReadCamera(name=Path(view.name).stem, setup=co.setup_of(own), photo=photo))
    centers = alignment.camera_centers(viewmats)
    read_points = None
    if points and len(cloud):
        columns = sfm_points.columns(cloud, capture.points.colors[finite], np.flatnonzero(finite))
        radius = sfm_points.point_radius(cloud, centers)
        read_points = ReadPoints(count=len(cloud), columns=columns, radius=radius)
    reader_warnings = map(panel_text, capture.warnings)
    return ReadCapture(
        source=source,
        images=images,
        up=up,
        photo_up=photo_up,
        origin=capture.origin,
        matrix=matrix,
        cameras=tuple(cameras),
        points=read_points,
        drawing=drawing_of(centers),
        copies=tuple(copies),
        warnings=(*reader_warnings, *lenses.problems, *_warnings(views, centers)),
    )


class _Lenses:
    """Lenses of a capture, each processed once."""

    def __init__(self) -> None:
        self.problems: list[str] = []
        """Sentences about lenses that cannot be undistorted."""
        self._known: dict[tuple, Undistortion | None] = {}

    def undistortion(self, camera: ColmapCamera) -> Undistortion | None:
        """Undistortion of a camera's photos; None: no distortion, or it cannot be undistorted."""
        key = (camera.model, camera.width, camera.height, *camera.params.tolist())
        if key not in self._known:
            try:
                self._known[key] = plan_undistortion(camera)
            except GsError as error:
                self._known[key] = None
                self.problems.append(
                    f"{error_text(error)} Until then its photos do not fit their cameras."
                )
        return self._known[key]


def _stated(view: View, plan: Undistortion | None) -> co.PhotoCamera:
    camera = view.camera
    pinhole = camera if plan is None else plan
    return co.PhotoCamera(
        image=view.name,
        photo=str(view.image),
        viewmat=view.viewmat,
        K=pinhole.K,
        width=pinhole.width,
        height=pinhole.height,
        model=camera.model,
        params=tuple(camera.params.tolist()),
        photo_size=None if plan is None else (camera.width, camera.height),
    )


def _warnings(views: list[View], centers: np.ndarray) -> list[str]:
    out = []
    usable = [view for view in views if view.camera.model not in NO_PINHOLE]
    if len(usable) < len(views):
        out.append(
            f"{len(views) - len(usable)} panoramas were left out: they are not pinhole cameras."
        )
    Ks = np.stack([view.camera.K for view in usable])
    if np.abs(Ks[:, 1, 1] / Ks[:, 0, 0] - 1).max() > 1e-3:
        out.append(
            "fx and fy differ. Blender stores the pixel aspect per scene: choose cameras with Use "
            "Camera, which sets it."
        )
    if len({(view.camera.width, view.camera.height) for view in usable}) > 1:
        out.append(
            "The photos differ in size. Blender stores the resolution per scene: choose cameras "
            "with Use Camera, which sets it."
        )
    extent = alignment.camera_extent(centers)
    if extent > 0 and np.linalg.norm(centers, axis=1).max() > FAR * extent:
        out.append(
            "The capture is far from its origin, where Blender's single precision visibly shifts "
            "cameras. Delete it here and import it again."
        )
    return out
