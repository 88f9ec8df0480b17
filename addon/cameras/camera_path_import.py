"""A file of a camera path as an animated Blender camera: the way back of `camera_path`."""

import re
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..core import Cameras, read_camera_path, rotmat_to_quat
from ..interface import writable
from ..interface.flags import panel_words
from . import formulas as cm
from . import objects as co

_NUMBER = re.compile(r"(\d+)\D*$")
_SAME = 1e-6
"""Relative difference below which pictures have one shape."""
_LAST = 1_000_000
"""Frame at which numbers are no longer those of frames; Blender's timeline ends there."""


@dataclass(frozen=True, kw_only=True)
class ImportedPath:
    """What `import_path` made."""

    camera: bpy.types.Object
    frames: tuple[int, int]
    """The first and the last frame of the timeline."""
    count: int
    """Cameras of the file."""
    frame: cm.Frame
    """The pictures' raster."""
    fps: float | None
    """Frames of the timeline a second, where the file states how many pictures."""
    warnings: tuple[str, ...]
    """Sentences for the user."""


def import_path(
    path: str | Path,
    scene: bpy.types.Scene,
    *,
    root: bpy.types.Object | None = None,
    start: int = 1,
    numbered: bool = True,
) -> ImportedPath:
    """Make a camera with a keyframe of place, turn and lens for each camera of a file.

    Args:
        path: Of `export_camera_path`, nerfstudio's viewer, or a transforms.json.
        scene: Gets the camera, in the collection of `root` or in its own.
        root: A capture's empty, in whose world the file is; None: Blender's world.
        start: Frame of the first camera; the others follow one by one.
        numbered: Take the numbers that the cameras' names end with instead, where they rise.

    Raises:
        GsError: the file cannot be read.
        ValueError: its pictures have several shapes, which one camera cannot have.
    """
    read = read_camera_path(path)
    cameras = read.cameras
    lenses, frame = _lenses(cameras, Path(path).name)
    numbers = _numbers(cameras.names, start, numbered=numbered)
    ob = _camera(Path(path).stem, scene, root)
    co.set_lens(ob.data, lenses[0])
    poses = np.stack([cm.matrix_world_from_viewmat(viewmat) for viewmat in cameras.viewmats])
    for number, lens, pose, quat in zip(numbers, lenses, poses, _turns(poses), strict=True):
        ob.location, ob.rotation_quaternion = pose[:3, 3], quat
        ob.data.lens, ob.data.shift_x, ob.data.shift_y = lens.lens, lens.shift_x, lens.shift_y
        for name in ("location", "rotation_quaternion"):
            ob.keyframe_insert(name, frame=number)
        for name in _moving(lenses):
            ob.data.keyframe_insert(name, frame=number)
    return ImportedPath(
        camera=ob,
        frames=(numbers[0], numbers[-1]),
        count=len(cameras),
        frame=frame,
        fps=None if read.fps is None else read.fps * _frames_a_picture(numbers),
        warnings=tuple(map(panel_words, read.warnings)),
    )


def use_path(scene: bpy.types.Scene, made: ImportedPath) -> None:
    """Let a scene render what the file describes: camera, size, pixel aspect, range and pace."""
    render = scene.render
    scene.camera = made.camera
    render.resolution_x, render.resolution_y = made.frame.width, made.frame.height
    render.resolution_percentage = 100
    render.pixel_aspect_x, render.pixel_aspect_y = (
        made.frame.pixel_aspect_x,
        made.frame.pixel_aspect_y,
    )
    scene.frame_start, scene.frame_end = made.frames
    scene.frame_step = 1
    if made.fps is not None:
        whole = max(1, round(made.fps))
        render.fps, render.fps_base = whole, whole / made.fps


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
            f"{name} has pictures or pixels of several shapes, but a scene of Blender has one: "
            f"export each part of it as a path of its own."
        )
    sensor = max(36.0, cm.MIN_LENS * width / float(Ks[:, 0, 0].min()))
    made = [cm.lens_from_intrinsics(K, width, height, sensor_width=sensor) for K in Ks]
    return [lens for lens, _ in made], made[0][1]


def _numbers(names: tuple[str, ...], start: int, *, numbered: bool) -> list[int]:
    """The frames of the timeline that show the cameras."""
    ends = [_NUMBER.search(Path(name).stem) for name in names]
    stated = [int(end.group(1)) for end in ends if end is not None]
    rising = len(stated) == len(names) and all(np.diff(stated) > 0) and stated[-1] <= _LAST
    return stated if numbered and rising else list(range(start, start + len(names)))


def _frames_a_picture(numbers: list[int]) -> float:
    """Of the timeline, in the mean: files of every so many-th frame have so many fewer pictures a
    second."""
    return (numbers[-1] - numbers[0]) / max(len(numbers) - 1, 1) or 1.0


def _turns(poses: np.ndarray) -> np.ndarray:
    """[C, 4] quaternions of poses [C, 4, 4], each of the sign that is near the one before."""
    quats = rotmat_to_quat(poses[:, :3, :3])
    for i in range(1, len(quats)):
        if quats[i] @ quats[i - 1] < 0:
            quats[i] = -quats[i]
    return quats


def _moving(lenses: list[cm.Lens]) -> list[str]:
    """Which properties of the lens change."""
    names = ("lens", "shift_x", "shift_y")
    return [name for name in names if len({getattr(lens, name) for lens in lenses}) > 1]


def _camera(name: str, scene: bpy.types.Scene, root: bpy.types.Object | None) -> bpy.types.Object:
    ob = bpy.data.objects.new(name, bpy.data.cameras.new(name))
    ob.rotation_mode = "QUATERNION"
    ob.parent = root
    places = root.users_collection if root is not None else ()
    writable.taking(places)[0].objects.link(ob)
    photos = co.cameras_of(root) if root is not None else []
    if photos:
        own = photos[0].data
        ob.data.clip_start, ob.data.clip_end = own.clip_start, own.clip_end
    return ob
