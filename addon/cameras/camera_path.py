"""Camera path export: an animated Blender camera to a path file, one camera per frame; operators of
export and import.
"""

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import ClassVar

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper, ImportHelper

from ..core import Cameras, atomic_write, file_errors, write_cameras, write_nerfstudio_path
from ..interface.base_operator import OnScene
from ..interface.incremental_operator import IncrementalOperator
from ..paths import chosen_file
from ..process import incremental_tasks
from ..process.incremental_tasks import BUDGET, Check, Steps, run_in_thread
from . import objects as co
from .camera_path_import import importing_path, use_path
from .capture_transform import origin_of
from .captures import activate
from .export_transforms import transforms_text
from .export_views import ExportView, Tracked, in_file_coordinates
from .lookup import OnCapture, find_root, roots_of

CAMERAS, TRANSFORMS, NERFSTUDIO = "CAMERAS", "TRANSFORMS", "NERFSTUDIO"
"""File formats: cameras.json, transforms.json, nerfstudio's camera_path.json."""


def exporting_path(
    path: str | Path,
    camera: bpy.types.Object,
    scene: bpy.types.Scene,
    *,
    root: bpy.types.Object | None,
    kind: str,
) -> Steps[int]:
    """Write the pose and lens of a camera at each frame of the scene's range.

    Writes every `frame_step`-th frame, like a render of the animation, at fps / `frame_step`, so
    that the duration stays. Each step restores the scene's current frame. The formats have no
    depth of field, motion blur or clipping distances. Times go from 0 at the first frame to 1 at
    the last, as readers of dynamic scenes expect; a cameras.json has none. Cancellation leaves the
    file unchanged.

    Args:
        path: The file to write.
        camera: A perspective camera; its lens, sensor and shift may be animated.
        scene: Defines range, frame rate, resolution and pixel aspect, as at the first step.
        root: A capture's empty, whose world is written; None: Blender's world.
        kind: CAMERAS, TRANSFORMS or NERFSTUDIO.

    Returns:
        Number of written frames.

    Raises:
        GsError: the file cannot be written.
        ValueError: the camera is orthographic, panoramic or sheared at some frame; the format
            cannot represent its lens; or the camera, the scene, its resolution or the capture
            changed meanwhile.
    """
    path = Path(path)
    origin = origin_of(root)
    pace = scene.render.fps / scene.render.fps_base / scene.frame_step
    with incremental_tasks.defer_collections():
        views = yield from _reading(camera, scene, root)
        write = partial(_write, path, views, kind, pace, origin)
        yield from run_in_thread(write, f"Writing {path}")
    return len(views)


def _reading(
    camera: bpy.types.Object, scene: bpy.types.Scene, root: bpy.types.Object | None
) -> Steps[list[ExportView]]:
    numbers = range(scene.frame_start, scene.frame_end + 1, scene.frame_step)
    tracked, raster = Tracked([camera], scene, root), co.frame_of(scene)
    views: list[ExportView] = []
    while True:
        views += _some_frames(tracked, numbers[len(views) :])
        if len(views) == len(numbers):
            return views
        yield f"Reading frames: {len(views)} of {len(numbers)}"
        tracked.refresh()
        if co.frame_of(tracked.scene) != raster:
            raise ValueError(
                "The resolution was changed while the camera was exported: export it again."
            )


def _some_frames(tracked: Tracked, numbers: Sequence[int]) -> list[ExportView]:
    """The camera at the first of some frames, until the time budget is used up."""
    views, scene = [], tracked.scene
    until = time.perf_counter() + BUDGET
    current, part = scene.frame_current, scene.frame_subframe
    try:
        for number in numbers:
            scene.frame_set(number)
            # Not the context's, because the window may show another scene by now.
            graph = scene.view_layers[0].depsgraph
            view = tracked.view(0, graph, photos=False)
            views.append(replace(view, name=f"frame_{number:06d}.png", photo=None))
            if time.perf_counter() > until:
                break
    finally:
        scene.frame_set(current, subframe=part)
    return views


def _write(
    path: Path,
    views: list[ExportView],
    kind: str,
    pace: float,
    origin: np.ndarray | None,
    check: Check,
) -> None:
    """Write the file; no bpy. Only a cameras.json can store a local origin."""
    if kind != CAMERAS:
        views = in_file_coordinates(views, origin)
    with file_errors(check):
        if kind == TRANSFORMS:
            times = np.linspace(0, 1, len(views)).tolist()
            text = transforms_text(views, path.parent, {"fps": pace}, times=times)
            atomic_write(path, text.encode())
        elif kind == NERFSTUDIO:
            write_nerfstudio_path(path, _pinholes(views), fps=pace)
        else:
            write_cameras(path, replace(_pinholes(views), origin=origin))


def _pinholes(views: list[ExportView]) -> Cameras:
    Ks = np.tile(np.eye(3), (len(views), 1, 1))
    for K, view in zip(Ks, views, strict=True):
        if view.camera.model != "PINHOLE":
            raise ValueError(
                f"{view.name} has the camera model {view.camera.model}, but cameras.json and "
                f"camera_path.json support only PINHOLE. Export a transforms.json."
            )
        K[[0, 1, 0, 1], [0, 1, 2, 2]] = view.camera.params
    return Cameras(
        viewmats=np.stack([view.viewmat for view in views]).astype(np.float64),
        Ks=Ks,
        widths=np.array([view.camera.width for view in views], np.int64),
        heights=np.array([view.camera.height for view in views], np.int64),
        names=tuple(view.name for view in views),
    )


_BLENDER = ("BLENDER", "Blender", "Blender's world: z up, as aligned and scaled")


class ExportCameraPath(IncrementalOperator, OnCapture, bpy.types.Operator, ExportHelper):
    """Export the scene camera's animation as a file with one camera per frame"""

    bl_idname = "gscore.export_camera_path"
    bl_label = "Export Camera Path"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    filename_ext = ".json"
    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})
    kind: EnumProperty(
        name="Format",
        items=(
            (CAMERAS, "cameras.json", "For gscore render and 3DGS viewers; without times"),
            (
                TRANSFORMS,
                "transforms.json",
                "For gscore render and others, with times from 0 to 1 and the frame rate",
            ),
            (
                NERFSTUDIO,
                "camera_path.json",
                "For nerfstudio's viewer, ns-render and gscore render; without lens shift. By "
                "default nerfstudio rotates and scales captures",
            ),
        ),
        description="File format",
    )
    world: EnumProperty(
        name="World",
        items=(
            ("CAPTURE", "Capture", "Coordinates of the capture's files and of its splat files"),
            _BLENDER,
        ),
        description="Axes, origin and scale of the exported cameras",
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the file."""
        return ExportHelper.invoke(self, context, event)

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Read the frames, then write in a thread."""
        path, camera = chosen_file(self.filepath), context.scene.camera
        if camera is None:
            raise ValueError("The scene has no camera. Make one the scene camera and animate it.")
        root = find_root(context, self.capture) if self.world == "CAPTURE" else None
        name = camera.name
        count = yield from exporting_path(path, camera, context.scene, root=root, kind=self.kind)
        return f"{path}: {count} frames of {name}"


class ImportCameraPath(IncrementalOperator, OnCapture, OnScene, bpy.types.Operator, ImportHelper):
    """Create an animated camera from a file with one camera per frame: a cameras.json, the
    camera_path.json of nerfstudio's viewer, or a transforms.json"""

    bl_idname = "gscore.import_camera_path"
    bl_label = "Import Camera Path"

    filename_ext = ".json"
    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})
    world: EnumProperty(
        name="World",
        items=(
            ("CAPTURE", "Capture", "Coordinates of the capture's files"),
            _BLENDER,
        ),
        description="Axes, origin and scale of the file",
    )
    numbered: BoolProperty(
        name="Frames from Names",
        description="Use increasing numbers at the end of the cameras' names as timeline frames, "
        "in place of Start",
        default=True,
    )
    start: IntProperty(
        name="Start", description="Frame of the first camera; the others follow", default=1
    )
    set_up_scene: BoolProperty(
        name="Set Up Scene",
        description="Make it the scene camera, with the file's resolution, range and frame rate",
        default=True,
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the file."""
        if not self.properties.is_property_set("world") and not roots_of(context.scene):
            self.world = "BLENDER"
        return ImportHelper.invoke(self, context, event)

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Read the file in a thread, then create the camera."""
        path = chosen_file(self.filepath)
        root = find_root(context, self.capture) if self.world == "CAPTURE" else None
        options = {"root": root, "start": self.start, "numbered": self.numbered}
        set_up_scene = self.set_up_scene
        made = yield from importing_path(path, context.scene, **options)
        if set_up_scene:
            use_path(made.scene, made)
        activate(made.scene, made.camera)
        self.warn(made.path.warnings)
        numbers = made.path.numbers
        span = f"frames {numbers[0]} to {numbers[-1]}"
        return f"{made.camera.name}: {len(numbers)} cameras, {span}"


def _draw_import(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    self.layout.operator(ImportCameraPath.bl_idname, text="Camera Path (.json)")


APPENDED = ((bpy.types.TOPBAR_MT_file_import, _draw_import),)
