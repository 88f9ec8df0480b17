"""Camera path import: a path file to an animated Blender camera, the inverse of `camera_path`."""

import re
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import bpy
import numpy as np

from ..compat import curves_of
from ..core import Cameras, offset_between, read_camera_path, rotmat_to_quat
from ..interface import editable_check
from ..interface.blocks import block_of
from ..interface.option_labels import panel_text
from ..interface.temporary_data import Temporary
from ..process import incremental_tasks
from ..process.incremental_tasks import BUDGET, Check, Steps, run_in_thread
from . import camera_math as cm
from . import objects as co
from .capture_transform import origin_of

_NUMBER = re.compile(r"(\d+)\D*$")
_SAME = 1e-6
"""Largest relative difference of equal pixel aspects."""
_LAST = 1_000_000
"""Last frame of Blender's timeline; larger numbers in names are not frames."""


@dataclass(frozen=True, kw_only=True)
class ImportedPath:
    """Result of an import."""

    scene: bpy.types.Scene
    camera: bpy.types.Object
    path: "ReadPath"


def importing_path(
    path: str | Path,
    scene: bpy.types.Scene,
    *,
    root: bpy.types.Object | None = None,
    start: int = 1,
    numbered: bool = True,
) -> Steps[ImportedPath]:
    """Create a camera with a keyframe of location, rotation and lens for each camera of a file; it
    enters the scene when complete.

    Args:
        path: File of `export_camera_path`, nerfstudio's viewer, or a transforms.json.
        scene: Receives the camera, in the collection of `root` or in its own.
        root: A capture's empty, whose world the file uses; None: Blender's world.
        start: Frame of the first camera; the others follow one by one.
        numbered: Use the numbers at the end of the cameras' names instead, if they increase.

    Raises:
        GsError: the file cannot be read.
        ValueError: its pictures differ in aspect, which one camera cannot have, or the scene or
            the capture was removed meanwhile.
    """
    path, uid = Path(path), scene.session_uid
    origin = None if root is None else offset_between(origin_of(root), None)
    root_uid = None if root is None else root.session_uid
    with incremental_tasks.defer_collections():
        read = yield from run_in_thread(
            partial(_read, path, start, numbered, origin), f"Reading {path}"
        )
        while True:
            pending = _PendingCamera(read)
            try:
                yield from pending.fill()
                gone = "The {} of this import was removed; import the camera path again."
                scene = block_of(bpy.data.scenes, uid, gone.format("scene"))
                above = root_uid and block_of(bpy.data.objects, root_uid, gone.format("capture"))
                camera = pending.link(scene, above)
            finally:
                pending.drop()
            if camera is not None:
                return ImportedPath(scene=scene, camera=camera, path=read)


def use_path(scene: bpy.types.Scene, made: ImportedPath) -> None:
    """Set a scene to the file's camera, size, pixel aspect, range and frame rate."""
    render, frame, numbers, fps = scene.render, made.path.frame, made.path.numbers, made.path.fps
    scene.camera = made.camera
    render.resolution_x, render.resolution_y = frame.width, frame.height
    render.resolution_percentage = 100
    render.pixel_aspect_x, render.pixel_aspect_y = frame.pixel_aspect_x, frame.pixel_aspect_y
    scene.frame_start, scene.frame_end = numbers[0], numbers[-1]
    scene.frame_step = 1
    if fps is not None:
        whole = max(1, round(fps))
        render.fps, render.fps_base = whole, whole / fps


@dataclass(frozen=True, kw_only=True)
class _Column:
    """Values of one F-curve."""

    of_lens: bool
    """True if it animates the camera datablock, else the object."""
    name: str
    """Name of the property."""
    index: int
    """Index in the property, from 0."""
    values: np.ndarray
    """[C] values, one per camera."""


@dataclass(frozen=True, kw_only=True)
class ReadPath:
    """A path file, converted for Blender."""

    name: str
    lens: cm.Lens
    """Lens of the first camera."""
    numbers: list[int]
    """Timeline frames, one per camera."""
    columns: list[_Column]
    frame: cm.Frame
    """The pictures' raster."""
    fps: float | None
    """Timeline frames per second; None: the file has no frame rate."""
    warnings: tuple[str, ...]
    """Sentences for the user."""


def _read(
    path: Path, start: int, numbered: bool, origin: np.ndarray | None, check: Check
) -> ReadPath:
    """Read a file; no bpy. `origin` [3] is the local origin of the capture's world, None: no
    capture."""
    read = read_camera_path(path)
    check()
    cameras = read.cameras if origin is None else read.cameras.of_splats(origin)
    lenses, frame = _lenses(cameras, path.name)
    numbers = _numbers(cameras.names, start, numbered=numbered)
    # Above 1 if frames were skipped.
    frames_a_picture = (numbers[-1] - numbers[0]) / max(len(numbers) - 1, 1) or 1.0
    poses = np.stack([cm.matrix_world_from_viewmat(viewmat) for viewmat in cameras.viewmats])
    tables = {"location": poses[:, :3, 3], "rotation_quaternion": _turns(poses)}
    columns = [
        _Column(of_lens=False, name=name, index=i, values=values)
        for name, table in tables.items()
        for i, values in enumerate(table.T)
    ]
    for name in ("lens", "shift_x", "shift_y"):
        values = np.array([getattr(lens, name) for lens in lenses])
        if np.ptp(values):
            columns.append(_Column(of_lens=True, name=name, index=0, values=values))
    return ReadPath(
        name=path.stem,
        lens=lenses[0],
        numbers=numbers,
        columns=columns,
        frame=frame,
        fps=None if read.fps is None else read.fps * frames_a_picture,
        warnings=tuple(map(panel_text, read.warnings)),
    )


class _PendingCamera:
    """A camera being created, in a collection outside all scenes."""

    def __init__(self, path: ReadPath) -> None:
        """Create the camera with the first keyframes."""
        self._path = path
        outer = bpy.data.collections.new(path.name)
        self._temporary = Temporary(outer)
        ob = bpy.data.objects.new(path.name, bpy.data.cameras.new(path.name))
        outer.objects.link(ob)
        self._temporary.mark(ob)
        ob.rotation_mode = "QUATERNION"
        for name, value in co.lens_changes(ob.data, path.lens).items():
            setattr(ob.data, name, value)
        for column in path.columns:
            if not column.of_lens:
                getattr(ob, column.name)[column.index] = column.values[0]
        for of_lens, name in dict.fromkeys((one.of_lens, one.name) for one in path.columns):
            (ob.data if of_lens else ob).keyframe_insert(name, frame=path.numbers[0])

    def fill(self) -> Steps[None]:
        """Create the other keyframes, one curve after the other."""
        columns, until = self._path.columns, time.perf_counter() + BUDGET
        for done, column in enumerate(columns):
            if time.perf_counter() > until:
                yield f"Importing keyframes: curve {done} of {len(columns)}"
                until = time.perf_counter() + BUDGET
            if (outer := self._temporary.found()) is None:
                return
            ob = outer.objects[0]
            curves = curves_of(ob.data if column.of_lens else ob)
            place = column.name, column.index
            curve = next(one for one in curves if (one.data_path, one.array_index) == place)
            _fill(curve, self._path.numbers, column.values)

    def link(
        self, scene: bpy.types.Scene, root: bpy.types.Object | None
    ) -> bpy.types.Object | None:
        """Link the camera to the scene; None: undo or the user has removed it."""
        if (outer := self._temporary.take()) is None:
            return None
        ob = outer.objects[0]
        ob.parent = root
        places = root.users_collection if root is not None else ()
        editable_check.taking([*places, scene.collection])[0].objects.link(ob)
        bpy.data.collections.remove(outer)
        photos = co.cameras_of(root) if root is not None else []
        if photos:
            own = photos[0].data
            ob.data.clip_start, ob.data.clip_end = own.clip_start, own.clip_end
        return ob

    def drop(self) -> None:
        """Remove the camera unless it was linked to the scene."""
        self._temporary.drop()


def _fill(curve: bpy.types.FCurve, numbers: list[int], values: np.ndarray) -> None:
    """Add the keyframes of all frames to a curve with one; equal to Blender's insertion, but
    hundreds of times faster."""
    points = curve.keyframe_points
    points.add(len(numbers) - 1)
    for name in ("amplitude", "back", "period"):  # unset in added keyframes
        like = getattr(points[0], name)
        points.foreach_set(name, np.full(len(numbers), like, np.float32))
    points.foreach_set("co", np.stack([numbers, values], axis=1).astype(np.float32).ravel())
    curve.update()


def _lenses(cameras: Cameras, name: str) -> tuple[list[cm.Lens], cm.Frame]:
    """Blender's lens of each camera, all with one sensor, and the raster of the first."""
    width, height = int(cameras.widths[0]), int(cameras.heights[0])
    Ks = cameras.Ks.copy()
    Ks[:, 0] *= (width / cameras.widths)[:, None]
    Ks[:, 1] *= (height / cameras.heights)[:, None]
    shapes = cameras.widths / cameras.heights * height / width
    stretches = Ks[:, 1, 1] / Ks[:, 0, 0]
    if (np.abs(shapes - 1) > 1 / min(width, height)).any() or np.ptp(stretches) > _SAME:
        raise ValueError(
            f"The pictures or pixels in {name} differ in aspect ratio, but a Blender scene has "
            f"one: export each part as a separate path."
        )
    sensor = max(36.0, cm.MIN_LENS * width / float(Ks[:, 0, 0].min()))
    made = [cm.lens_from_intrinsics(K, width, height, sensor_width=sensor) for K in Ks]
    return [lens for lens, _ in made], made[0][1]


def _numbers(names: tuple[str, ...], start: int, *, numbered: bool) -> list[int]:
    """Timeline frames of the cameras."""
    ends = [_NUMBER.search(Path(name).stem) for name in names]
    stated = [int(end.group(1)) for end in ends if end is not None]
    rising = len(stated) == len(names) and all(np.diff(stated) > 0) and stated[-1] <= _LAST
    return stated if numbered and rising else list(range(start, start + len(names)))


def _turns(poses: np.ndarray) -> np.ndarray:
    """[C, 4] quaternions of poses [C, 4, 4], with signs for shortest interpolation."""
    quats = rotmat_to_quat(poses[:, :3, :3])
    for i in range(1, len(quats)):
        if quats[i] @ quats[i - 1] < 0:
            quats[i] = -quats[i]
    return quats
