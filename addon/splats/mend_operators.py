"""Operator that transforms shapes and colors after Blender's Apply and Join."""

from collections.abc import Iterable
from typing import ClassVar

import bpy

from ..interface.incremental_operator import IncrementalOperator
from ..process.incremental_tasks import Pieces
from . import mending, objects
from .edit_guard import EditGuard


class MendSplats(IncrementalOperator, bpy.types.Operator):
    """Rotate and scale shapes and colors of splats whose positions alone were changed by Blender's
    Apply or Join; stretched splats get their earlier positions and object scale back"""

    bl_idname = "gscore.mend_splats"
    bl_label = "Update Shapes and Colors"
    bl_options: ClassVar = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """True if shapes lag in the active or a selected splat object."""
        if mending.behind(context):
            return True
        cls.poll_message_set("Shapes and colors of the selected splats match their positions")
        return False

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """Their points and transforms."""
        return [block for ob in mending.behind(context) for block in (ob.data, ob)]

    def pieces(self, context: bpy.types.Context) -> Pieces[str]:
        """Correct each mesh once."""
        obs = {ob.data: ob for ob in reversed(mending.behind(context))}.values()
        names = ", ".join(ob.name for ob in obs)
        context.view_layer.update()  # else the guards would detect earlier changes
        guards = []
        try:
            for ob in obs:
                objects.catch_up(ob)
                guards.append(EditGuard(ob))
            stretched = yield from mending.mended(guards)
        finally:
            for guard in guards:
                guard.close()
        if stretched:
            names = ", ".join(ob.name for ob in stretched)
            return f"Restored the uneven scale of {names}. Make Scale Even makes it uniform."
        return f"Updated shapes and colors of {names}."


CLASSES = (MendSplats,)
