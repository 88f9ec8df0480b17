"""Fixes of render settings: Cycles' limit of splats along a ray, whose default is too low, and
sides of a video that its codec cannot encode.
"""

import bpy

from .. import compat
from ..cameras.objects import frame_of
from ..interface.base_operator import Condition, OnScene
from ..splats.objects import is_splats

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


def problem(scene: bpy.types.Scene) -> str:
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
    needs = Condition(lambda context: bool(problem(context.scene)))

    def run(self, context: bpy.types.Context) -> str:
        """Raise the resolution, with its percentage kept."""
        render = context.scene.render
        while frame_of(context.scene).width % 2:
            render.resolution_x += 1
        while frame_of(context.scene).height % 2:
            render.resolution_y += 1
        return f"The resolution is now {render.resolution_x} x {render.resolution_y}."
