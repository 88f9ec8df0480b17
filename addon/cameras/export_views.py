"""Export views: Blender cameras in the form that all export formats share.

Unmoved cameras have the float64 values of the capture; moved ones have Blender's single precision.
"""

import time
from collections.abc import Callable, Iterator, Sequence, Sized
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import bpy
import numpy as np

from ..core import ColmapCamera, file_errors, moved_viewmats, offset_between
from ..interface.blocks import first_few
from ..process.incremental_tasks import BUDGET, Check, Steps
from . import camera_math as cm
from . import objects as co
from .undistorted_photos import lens_of


@dataclass(frozen=True, kw_only=True)
class ExportView:
    """A camera to write."""

    name: str
    """Image name, sub-folders with '/'."""
    photo: Path | None
    """File of the photo; None for cameras without one."""
    viewmat: np.ndarray
    """[4, 4] float64, world to camera, OpenCV axes."""
    camera: ColmapCamera
    """Intrinsics."""
    is_moved: bool
    """True if pose or lens are Blender's, not the capture's."""
    is_lens_kept: bool = False
    """True if a lens with distortion is the capture's although it was changed in Blender, because
    the photo fits only that lens."""


@dataclass(frozen=True, kw_only=True)
class Exported:
    """Result of an export."""

    path: Path
    """Folder of the model, or the transforms file."""
    views: int
    """Number of cameras."""
    moved: int
    """Cameras written with Blender's values instead of the capture's."""
    points: int
    """Number of SfM points."""
    warnings: tuple[str, ...] = ()
    """Warnings for the user."""

    @classmethod
    def of(
        cls, path: Path, views: Sequence[ExportView], points: Sized, warnings: Sequence[str]
    ) -> "Exported":
        """The result of written views and points."""
        moved, counts = sum(view.is_moved for view in views), (len(views), len(points))
        return cls(
            path=path, views=counts[0], moved=moved, points=counts[1], warnings=tuple(warnings)
        )


def collecting(tracked: "Tracked") -> Steps[list[ExportView]]:
    """The cameras to write, with unique names.

    Raises:
        ValueError: there are none, one is orthographic, panoramic or sheared, or the scene was
            changed meanwhile.
    """
    count = len(tracked.cameras)
    if not count:
        raise ValueError("There are no cameras to export. Select some, or import a capture.")
    frame = tracked.scene.frame_current_final
    views: list[ExportView] = []
    taken: set[str] = set()
    graph, until = tracked.depsgraph(), time.perf_counter() + BUDGET
    for done in range(count):
        if time.perf_counter() > until:
            yield f"Reading cameras: {done} of {count}"
            tracked.refresh()
            if tracked.scene.frame_current_final != frame:
                raise ValueError(
                    "The frame was changed while cameras were exported: export them again."
                )
            graph, until = tracked.depsgraph(), time.perf_counter() + BUDGET
        view = tracked.view(done, graph)
        name, number = view.name, 1
        while name in taken:
            path = PurePosixPath(view.name)
            name, number = str(path.with_name(f"{path.stem}_{number}{path.suffix}")), number + 1
        taken.add(name)
        views.append(replace(view, name=name))
    return views


def in_file_coordinates(views: Sequence[ExportView], origin: np.ndarray | None) -> list[ExportView]:
    """Views about a local origin, converted to the coordinates of the capture's files."""
    shift = offset_between(None, origin)
    return [replace(view, viewmat=moved_viewmats(view.viewmat, shift)) for view in views]


class Tracked:
    """Cameras to export, looked up again after each step: undo replaces objects."""

    def __init__(
        self,
        cameras: Sequence[bpy.types.Object],
        scene: bpy.types.Scene,
        root: bpy.types.Object | None,
        depsgraph: Callable[[], bpy.types.Depsgraph | None] = lambda: None,
    ) -> None:
        """Store the session uids.

        Args:
            cameras: Cameras of photos, or other perspective cameras.
            scene: Defines resolution and pixel aspect of cameras without a photo.
            root: A capture's empty: its world is written, with its points; None: Blender's world.
            depsgraph: Source of the current animated poses.
        """
        self.cameras, self.scene, self.root = list(cameras), scene, root
        self.depsgraph = depsgraph
        self._uids = [ob.session_uid for ob in cameras]
        self._others = scene.session_uid, None if root is None else root.session_uid

    def refresh(self) -> None:
        """Look up all objects; ValueError if one was removed."""
        obs = {ob.session_uid: ob for ob in bpy.data.objects}
        scenes = {scene.session_uid: scene for scene in bpy.data.scenes}
        scene, root = self._others
        is_there = scene in scenes and (root is None or root in obs)
        if not is_there or not all(uid in obs for uid in self._uids):
            gone = "Cameras were" if is_there else "The scene or the capture was"
            raise ValueError(f"{gone} removed while cameras were exported: export them again.")
        self.scene, self.root = scenes[scene], None if root is None else obs[root]
        self.cameras = [obs[uid] for uid in self._uids]

    def view(
        self, number: int, depsgraph: bpy.types.Depsgraph | None, *, photos: bool = True
    ) -> ExportView:
        """A camera to write.

        Args:
            number: Index in `cameras`.
            depsgraph: Source of the animated poses.
            photos: Write the lens of the original photos; else the pinhole camera of the
                undistorted photo.

        Raises:
            ValueError: it is orthographic, panoramic or sheared.
        """
        ob = self.cameras[number]
        if co.is_camera(ob):
            return _photo_view(ob, self.root, depsgraph, photos=photos)
        return _plain_view(ob, self.scene, self.root, depsgraph)


@contextmanager
def all_or_none(check: Check) -> Iterator[None]:
    """Write several files within; cancellation counts only before the first."""
    first = iter([check])
    with file_errors(lambda: next(first, lambda: None)()):
        yield


def kept_lenses(views: Sequence[ExportView]) -> list[str]:
    """At most one sentence about lenses that are not written as changed in Blender."""
    names = [view.name for view in views if view.is_lens_kept]
    if not names:
        return []
    return [
        f"The lens of {first_few(names)} was changed in Blender; the capture's lens is written, "
        f"because the photos have its distortion."
    ]


def _photo_view(
    ob: bpy.types.Object,
    root: bpy.types.Object | None,
    depsgraph: bpy.types.Depsgraph | None,
    *,
    photos: bool,
) -> ExportView:
    own = co.photo_camera_of(ob)
    camera = lens_of(own)
    moved = root is None or co.root_of(ob) != root or co.is_moved(ob, own)
    changed = co.is_lens_changed(_data(ob, depsgraph), own)
    kept = photos and changed and not camera.is_pinhole
    if (changed and not kept) or (own.photo_size is not None and not photos):
        _, frame = cm.lens_from_intrinsics(own.K, own.width, own.height)
        camera = _pinhole(_intrinsics(ob, frame, depsgraph), frame)
    return ExportView(
        name=own.image,
        photo=Path(own.photo) if own.photo else None,
        viewmat=_rigid(co.viewmat_in(ob, root, depsgraph)) if moved else own.viewmat,
        camera=camera,
        is_moved=moved or (changed and not kept),
        is_lens_kept=kept,
    )


def _plain_view(
    ob: bpy.types.Object,
    scene: bpy.types.Scene,
    root: bpy.types.Object | None,
    depsgraph: bpy.types.Depsgraph | None,
) -> ExportView:
    if ob.type != "CAMERA":
        raise ValueError(f"{ob.name} is not a camera. Select cameras only.")
    frame = co.frame_of(scene)
    letters = [c if c.isalnum() or c in " ._-" else "_" for c in ob.name]
    return ExportView(
        name="".join(letters).strip(" .") + ".png",
        photo=None,
        viewmat=_rigid(co.viewmat_in(ob, root, depsgraph)),
        camera=_pinhole(_intrinsics(ob, frame, depsgraph), frame),
        is_moved=True,
    )


def _intrinsics(
    ob: bpy.types.Object, frame: cm.Frame, depsgraph: bpy.types.Depsgraph | None
) -> np.ndarray:
    data = _data(ob, depsgraph)
    if data.type != "PERSP":
        raise ValueError(
            f"Camera {ob.name} is not perspective, which COLMAP and transforms.json have no model "
            f"for. Leave it out or change its type."
        )
    return cm.intrinsics(co.lens_of(data), frame)


def _data(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None) -> bpy.types.Camera:
    """Camera data with the animated lens, which the object lacks before its scene is shown."""
    return (ob.evaluated_get(depsgraph) if depsgraph else ob).data


def _pinhole(K: np.ndarray, frame: cm.Frame) -> ColmapCamera:
    params = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])
    return ColmapCamera(model="PINHOLE", width=frame.width, height=frame.height, params=params)


def _rigid(viewmat: np.ndarray) -> np.ndarray:
    """The nearest pose with a true rotation and the same camera centre."""
    u, _, vt = np.linalg.svd(viewmat[:3, :3])
    out = np.eye(4)
    out[:3, :3] = u @ vt
    center = -np.linalg.solve(viewmat[:3, :3], viewmat[:3, 3])
    out[:3, 3] = -out[:3, :3] @ center
    return out
