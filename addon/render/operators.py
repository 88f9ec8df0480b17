"""Render operators: set up the engine and its colours, compare with photos and the worst of them,
composite; fixes of render settings (Cycles' limit of splats along a ray, whose default is too low,
and sides of a video that its codec cannot encode); show splats as they were trained.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import bpy
from bpy.props import BoolProperty

from .. import compat, stored_paths
from ..cameras import captures
from ..cameras.objects import cameras_of, frame_of, is_camera, root_of
from ..capture.figures import figures
from ..interface.base_operator import Condition, OnScene, Undoable, make_active
from ..interface.images import show_soon
from ..interface.incremental_operator import IncrementalOperator
from ..process.incremental_tasks import Steps
from ..splats import splat_framing
from ..splats.error_maps import hide_refits, is_map, show_map, siblings, splats_in_view
from ..splats.objects import active_splats, has_trained, in_question, is_splats
from . import compare as comparing
from . import compositor
from .engine import ENGINE_BEFORE, NAME
from .picture import AUTO, OFF, ON


def use_engine(scene: bpy.types.Scene) -> None:
    """Render a scene with the Gaussian Splats engine, in the colours of the photos."""
    if scene.render.engine != NAME:
        scene[ENGINE_BEFORE] = scene.render.engine
    scene.render.engine = NAME
    use_photo_colors(scene)


def use_photo_colors(scene: bpy.types.Scene) -> None:
    """Reset settings that change colours between the splats and the file."""
    view = scene.view_settings
    view.view_transform = "Standard"  # resets the look where the new transform does not have it
    view.look = "None"
    view.exposure, view.gamma, view.use_curve_mapping = 0.0, 1.0, False
    if hasattr(view, "use_white_balance"):  # since 4.3
        view.use_white_balance = False
    scene.render.dither_intensity = 0.0


def changes_colors(scene: bpy.types.Scene) -> str:
    """Settings that change colours between the splats and the file; empty: none."""
    view = scene.view_settings
    found = []
    if view.view_transform != "Standard":
        found.append(f"View Transform {view.view_transform}")
    if view.look != "None":
        found.append(f"Look {view.look}")
    if view.exposure or view.gamma != 1 or view.use_curve_mapping:
        found.append("Exposure, Gamma or Curves")
    if getattr(view, "use_white_balance", False):
        found.append("White Balance")
    return ", ".join(found)


class UseEngine(OnScene, bpy.types.Operator):
    """Render with the engine Gaussian Splats in the colors of the photos (view transform
    Standard)"""

    bl_idname = "gscore.use_engine"
    bl_label = "Render with Gaussian Splats"

    def run(self, context: bpy.types.Context) -> None:
        """Set the scene's engine."""
        use_engine(context.scene)


class UsePhotoColors(OnScene, bpy.types.Operator):
    """Show and save colors as trained: view transform Standard, no look, no dither"""

    bl_idname = "gscore.use_photo_colors"
    bl_label = "Use the Colors of the Photos"

    def run(self, context: bpy.types.Context) -> None:
        """Set the scene's colour management."""
        use_photo_colors(context.scene)


class ComparePhoto(IncrementalOperator, bpy.types.Operator):
    """Show photo, render and error of an imported camera side by side, with the PSNR"""

    bl_idname = "gscore.compare_photo"
    bl_label = "Compare with Photo"

    camera: bpy.props.StringProperty(
        name="Camera",
        description="Name of an imported camera; empty: the active object, or the scene's camera",
    )

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Compare, show the pictures in an image editor, in a new window if need be, and report."""
        return (yield from compared(context, chosen_camera(context, self.camera)))


class CompareWorstPhoto(IncrementalOperator, bpy.types.Operator):
    """Compare with the photo of the lowest measured PSNR"""

    bl_idname = "gscore.compare_worst_photo"
    bl_label = "Compare Worst Photo"
    needs = Condition(has_trained, "Select splats that were trained with this add-on")

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Find the camera, compare from it, and make it the active object."""
        found = worst_photo_of(context.scene, active_splats(context))
        name = found.camera.name
        report = yield from compared(context, found.camera)
        if context.mode == "OBJECT" and (camera := context.view_layer.objects.get(name)):
            make_active(context, camera)
        return f"Worst of {found.among} photos, {found.psnr:.2f} dB when measured. {report}"


def compared(context: bpy.types.Context, camera: bpy.types.Object) -> Steps[str]:
    """Compare from a camera, show the pictures, and return the report."""
    with splats_in_view():
        begun = comparing.Comparing(context.scene, camera, context.evaluated_depsgraph_get())
    name = camera.name
    found = yield from begun.compared()
    shown = show_soon(context, found.images["Comparison"])
    where = "" if shown else f"; open the image {found.images['Comparison'].name} to see it"
    kind, psnr = "PSNR", found.psnr
    if found.psnr_masked is not None:
        kind, psnr = "PSNR inside the mask", found.psnr_masked
    value = "infinite" if math.isinf(psnr) else f"{psnr:.2f} dB"
    value += " at the exposure of the photo" if found.exposed else ""
    return f"{name}: {kind} {value}{where}."


class SetUpCompositing(OnScene, bpy.types.Operator):
    """Add a scene for the splats, and nodes that combine splats and meshes by depth"""

    bl_idname = "gscore.set_up_compositing"
    bl_label = "Composite Splats with Meshes"

    transparent: bpy.props.BoolProperty(
        name="Transparent Film",
        description="Render meshes with a transparent film, to blend their edges with splats",
        default=True,
    )

    def run(self, context: bpy.types.Context) -> str:
        """Set up or update the compositing."""
        made = compositor.set_up(context.scene, transparent=self.transparent)
        return f"Rendering {context.scene.name} now includes {made.name}."


class RemoveCompositing(OnScene, bpy.types.Operator):
    """Remove the splats' scene and the compositing nodes"""

    bl_idname = "gscore.remove_compositing"
    bl_label = "Remove Compositing"

    def run(self, context: bpy.types.Context) -> str:
        """Undo the set-up."""
        compositor.take_down(context.scene)
        return f"Rendering {context.scene.name} works as before compositing."


def chosen_camera(context: bpy.types.Context, name: str = "") -> bpy.types.Object:
    """The camera of that name, else the active object if it is a photo's camera, else the scene's.

    Raises:
        ValueError: there is none.
    """
    if name:
        found = context.scene.objects.get(name)
        if found is None:
            raise ValueError(f"Scene {context.scene.name} has no object {name}: name a camera.")
        return found
    for candidate in (context.view_layer.objects.active, context.scene.camera):
        if comparing.is_camera(candidate):
            return candidate
    raise ValueError("Select an imported camera, or make one the scene's, to compare its photo.")


@dataclass(frozen=True, kw_only=True)
class WorstPhoto:
    """The worst photo of a run."""

    camera: bpy.types.Object
    psnr: float
    """PSNR measured after the training, dB."""
    among: int
    """Number of measured photos with a camera in the scene."""


def worst_photo_of(scene: bpy.types.Scene, ob: bpy.types.Object) -> WorstPhoto:
    """The camera of the worst measured photo of the run that splats come from.

    Args:
        scene: Scene of the cameras, if the splats have no capture as parent.
        ob: The splats.

    Raises:
        ValueError: the splats come from no run, its evaluation cannot be read, or none of its
            photos has a camera in the scene.
    """
    folder = stored_paths.read(ob, stored_paths.RUN)
    if not folder:
        raise ValueError(f"{ob.name} was not trained with this add-on: its photos are not known.")
    run = figures(Path(folder))
    found = dict(run.ranked)
    root = root_of(ob)
    cameras = cameras_of(root) if root is not None else filter(is_camera, scene.objects)
    known = [
        (found[name], camera) for camera in cameras if (name := camera.get("gs_image")) in found
    ]
    if not known:
        raise ValueError(
            f"None of the photos in {run.path} has a camera here: import the cameras of that "
            "capture."
        )
    psnr, camera = min(known, key=lambda pair: pair[0])
    return WorstPhoto(camera=camera, psnr=psnr, among=len(known))


ENOUGH = 256
"""Transparent bounces above which a capture gets no brighter. Mean of a picture of plush with 8,
Blender's default, 32, 64, 128, 256 and 1024 bounces: 30, 78, 107, 121, 124 and 124."""
_SOFT = {"SOFT"} if compat.splat_cloud_type() else {"SOFT", "SPLATS"}
"""Displays that render as soft splats."""


def ends_early(scene: bpy.types.Scene) -> bool:
    """Whether soft splats render too dark, because rays of Cycles end among them."""
    if scene.render.engine != "CYCLES" or not hasattr(scene, "cycles"):
        return False
    if scene.cycles.transparent_max_bounces >= ENOUGH:
        return False
    return any(
        is_splats(ob) and ob.gscore.display in _SOFT and not ob.hide_render for ob in scene.objects
    )


class RaiseTransparentBounces(OnScene, bpy.types.Operator):
    """Raise the limit of transparent bounces in Cycles (Light Paths > Transparent) to the number of
    soft splats behind each other"""

    bl_idname = "gscore.see_through_splats"
    bl_label = "Raise Transparent Bounces"
    needs = Condition(lambda context: ends_early(context.scene))

    def run(self, context: bpy.types.Context) -> None:
        """Raise the limit."""
        context.scene.cycles.transparent_max_bounces = ENOUGH


_EVEN = {"H264", "H265", "PRORES"}
"""Codecs with one colour sample for several pixels, whose encoders refuse odd sides."""


def size_problem(scene: bpy.types.Scene) -> str:
    """Why Blender cannot write a scene's animation at its size; empty if it can."""
    render, frame = scene.render, frame_of(scene)
    if render.image_settings.file_format != "FFMPEG" or render.ffmpeg.codec not in _EVEN:
        return ""
    if frame.width % 2 == 0 and frame.height % 2 == 0:
        return ""
    return f"The video codec needs an even width and height, not {frame.width} x {frame.height}."


class MakeSizeEven(OnScene, bpy.types.Operator):
    """Raise the resolution to the next even width and height, because the codec of the output's
    videos refuses odd ones"""

    bl_idname = "gscore.make_size_even"
    bl_label = "Make Size Even"
    needs = Condition(lambda context: bool(size_problem(context.scene)))

    def run(self, context: bpy.types.Context) -> str:
        """Raise the resolution, with its percentage kept."""
        render = context.scene.render
        while frame_of(context.scene).width % 2:
            render.resolution_x += 1
        while frame_of(context.scene).height % 2:
            render.resolution_y += 1
        return f"The resolution is now {render.resolution_x} x {render.resolution_y}."


class ShowSplats(Undoable, bpy.types.Operator):
    """Show the splats as they were trained: set engine, colors and shading, hide photos, and align
    views with the photo camera of the most similar direction; it becomes the scene camera, or a new
    one does, if there is none but Blender's default"""

    bl_idname = "gscore.show_splats"
    bl_label = "Show Splats"

    trained: BoolProperty(
        name="Trained",
        description="Show the splats of the last training instead of the active object",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The scene, and hidden splats."""
        ob = _shown_object(context, trained=self.trained)
        return (context.scene, ob) if ob.hide_viewport or ob.hide_render else (context.scene,)

    def run(self, context: bpy.types.Context) -> None:
        """Apply all settings."""
        ob = _shown_object(context, trained=self.trained)
        splat_framing.frame_of(ob)  # raises for empty splats before anything is set
        if any(map(is_map, _of_run(context, ob))):
            show_map(ob, False)
        elif stored_paths.RUN in ob:
            hide_refits(ob)
        ob.hide_set(False)
        if ob.hide_viewport or ob.hide_render:
            ob.hide_viewport = ob.hide_render = False
        make_active(context, ob)
        use_engine(context.scene)
        captures.show_photos(context.scene, False)
        context.view_layer.update()  # to evaluate the matrix of hidden objects
        for space in splat_framing.turn_views(context.scene, ob):
            space.shading.type = "RENDERED"
        self.warn(splat_framing.set_camera(context.scene, ob))


def _shown_object(context: bpy.types.Context, *, trained: bool) -> bpy.types.Object:
    """The splats of the training if `trained`, else those that panels are about."""
    result = [context.scene.gscore.result] if trained else []
    for ob in (*result, in_question(context)):
        if is_splats(ob) and context.view_layer.objects.get(ob.name) == ob:
            splats = (other for other in _of_run(context, ob) if not is_map(other))
            return next(splats, ob) if is_map(ob) else ob
    raise ValueError("This scene shows no splats: train some, or import a splat PLY.")


def _of_run(context: bpy.types.Context, ob: bpy.types.Object) -> list[bpy.types.Object]:
    """The splats and error maps of an object's run that are in the view layer."""
    if not stored_paths.read(ob, stored_paths.RUN):
        return []
    splats, maps = siblings(ob)
    return [other for other in (*splats, *maps) if other.name in context.view_layer.objects]


def _passes_changed(settings: "RenderSettings", context: bpy.types.Context) -> None:
    """Give the compositor's nodes the sockets of the passes, as Blender's own switches do."""
    for layer in settings.id_data.view_layers:
        layer.update_render_passes()


class RenderSettings(bpy.types.PropertyGroup):
    """`Scene.gscore_render`: settings of the engine."""

    antialias: bpy.props.EnumProperty(
        name="Anti-Aliasing",
        description="Reduce the opacity of splats smaller than a pixel, because they are drawn "
        "wider than they are",
        items=[
            (AUTO, "As Trained", "On for models trained with it, off for others"),
            (ON, "On", "For models trained with it (Mip-Splatting)"),
            (OFF, "Off", "For all other models"),
        ],
        default=AUTO,
    )
    blur_samples: bpy.props.IntProperty(
        name="Blur Samples",
        description="Number of pictures averaged for depth of field or motion blur. Use more for "
        "smoother wide blur",
        default=32,
        min=1,
        max=4096,
        soft_max=512,
    )
    splat_index: bpy.props.BoolProperty(
        name="Splat Index",
        description="Pass with the index, in its object, of the splat at which half of the light "
        "is blocked; -1 where less is. The object is that of the pass Object Index",
        update=_passes_changed,
    )
    live: bpy.props.BoolProperty(
        name="Live Viewport",
        description="In Rendered shading, draw splats with the graphics card until the exact "
        "picture is ready",
        default=True,
    )


PROPERTIES = ((bpy.types.Scene, "gscore_render", bpy.props.PointerProperty(type=RenderSettings)),)
