"""Transparent bounces: Cycles' limit of splats along a ray, whose default is too low."""

from typing import ClassVar

import bpy

from .. import compat
from ..interface.base_operator import OnScene
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
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether Cycles renders with too few bounces."""
        return ends_early(context.scene)

    def act(self, context: bpy.types.Context) -> str:
        """Raise the limit."""
        context.scene.cycles.transparent_max_bounces = ENOUGH
        return ""


CLASSES = (RaiseTransparentBounces,)
