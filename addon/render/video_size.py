"""Video size: sides that the codec of a scene's animation can encode."""

from typing import ClassVar

import bpy

from ..cameras.objects import frame_of
from ..interface.base_operator import OnScene

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
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether the codec refuses the size."""
        return bool(problem(context.scene))

    def act(self, context: bpy.types.Context) -> str:
        """Raise the resolution, with its percentage kept."""
        render = context.scene.render
        while frame_of(context.scene).width % 2:
            render.resolution_x += 1
        while frame_of(context.scene).height % 2:
            render.resolution_y += 1
        return f"The resolution is now {render.resolution_x} x {render.resolution_y}."


CLASSES = (MakeSizeEven,)
