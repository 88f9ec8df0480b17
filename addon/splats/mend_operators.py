"""The operator that mends what Blender's Apply and Join leave."""

from collections.abc import Iterable
from typing import ClassVar

import bpy

from ..interface.incremental_operator import IncrementalOperator
from ..process.incremental_tasks import Pieces
from . import mending, objects
from .edit_guard import EditGuard


class MendSplats(IncrementalOperator, bpy.types.Operator):
    """Turn and scale shapes and colors of the splats along, where Apply or Join of Blender has
    moved their places alone; what was stretched gets its places and its scale of before"""

    bl_idname = "gscore.mend_splats"
    bl_label = "Turn Shapes and Colors Along"
    bl_options: ClassVar = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether something lags in the active splat object or a selected one."""
        if mending.behind(context):
            return True
        cls.poll_message_set("Shapes and colors of the selected splats are where they belong")
        return False

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """Their points, and where they stand."""
        return [block for ob in mending.behind(context) for block in (ob.data, ob)]

    def pieces(self, context: bpy.types.Context) -> Pieces[str]:
        """Mend each mesh once."""
        found = {ob.data: ob for ob in reversed(mending.behind(context))}.values()
        names = ", ".join(ob.name for ob in found)
        context.view_layer.update()  # what was done until now is no change
        helds = []
        try:
            for ob in found:
                objects.catch_up(ob)
                helds.append(EditGuard(ob))
            stretched = yield from mending.mended(helds)
        finally:
            for held in helds:
                held.close()
        if stretched:
            names = ", ".join(ob.name for ob in stretched)
            return f"Stretched as before: {names}. Make Scale Even gives one scale for all axes."
        return f"Shapes and colors follow in {names}."


CLASSES = (MendSplats,)
