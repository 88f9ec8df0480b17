"""Guide mesh operators: add objects to the collection of meshes that guide a training."""

from typing import ClassVar

import bpy
from bpy.props import EnumProperty

from ..interface.base_operator import OnScene
from . import guides


class AddGuides(OnScene, bpy.types.Operator):
    """Add the selected objects to the collection of meshes that guide the training"""

    bl_idname = "gscore.add_guides"
    bl_label = "Add Selected"
    bl_options: ClassVar = {"REGISTER", "UNDO"}

    role: EnumProperty(
        name="Role",
        description="Use of the meshes in the training",
        items=(
            ("surface", "Surface Mesh", "Splats are pulled onto these meshes"),
            ("free", "Free-Space Mesh", "Splats between the cameras and these meshes are removed"),
        ),
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """True if something is selected."""
        if context.selected_objects:
            return True
        cls.poll_message_set("Select the meshes first")
        return False

    def act(self, context: bpy.types.Context) -> str:
        """Link the objects."""
        obs = [ob for ob in context.selected_objects if guides.may_guide(ob)]
        if not obs:
            raise ValueError("None of the selected objects is a mesh or can be converted to one.")
        collection = guides.add_to_guides(context.scene, self.role, obs)
        return f"Added {len(obs)} objects to {collection.name}."


CLASSES = (AddGuides,)
