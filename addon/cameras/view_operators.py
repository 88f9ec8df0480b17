"""View operators that look through the cameras of photos."""

from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty

from ..interface.base_operator import OnScene
from . import captures
from .lookup import find_camera, find_root
from .objects import cameras_of
from .operators import OnCapture

_shown: list[tuple[str, str, str]] = []
"""Items of the last search, kept because Blender does not copy their strings."""


def _image_items(self: Any, context: bpy.types.Context | None) -> list[tuple[str, str, str]]:
    """The photos of the operator's capture."""
    try:
        listed = cameras_of(find_root(context, self.capture)) if context else []
    except ValueError:
        listed = []
    names = [str(ob.get("gs_image", ob.name)) for ob in listed]
    _shown[:] = [(name, name, "") for name in dict.fromkeys(names)] or [("NONE", "No photo", "")]
    return _shown


class UseCamera(OnScene, OnCapture, bpy.types.Operator):
    """Look through a photo's camera; sets the scene camera, resolution and pixel aspect"""

    bl_idname = "gscore.use_camera"
    bl_label = "Use Camera"

    camera: StringProperty(
        name="Camera",
        description="Name of the camera or of its photo; empty: by index",
        options={"SKIP_SAVE"},
    )
    index: IntProperty(
        name="Index",
        default=-1,
        min=-1,
        description="Index of the photo in the order of names, from 0; -1: the active camera, else "
        "the scene camera, else the first",
        options={"SKIP_SAVE"},
    )
    look_through: BoolProperty(
        name="Look Through", default=True, description="Turn the 3D view to the camera"
    )

    def act(self, context: bpy.types.Context) -> str:
        """Set the camera, and look through it."""
        root = find_root(context, self.capture)
        ob = find_camera(context, root, self.camera, self.index)
        self.warn(captures.use_camera(context.scene, ob))
        if self.look_through:
            _look_through(context)
        return ""


class StepCamera(OnScene, OnCapture, bpy.types.Operator):
    """Look through the next or the previous photo's camera"""

    bl_idname = "gscore.step_camera"
    bl_label = "Next Camera"

    step: IntProperty(name="Step", default=1, description="Photos to advance; negative: backwards")
    look_through: BoolProperty(
        name="Look Through", default=True, description="Turn the 3D view to the camera"
    )

    @classmethod
    def description(cls, context: bpy.types.Context, properties: Any) -> str:
        """Tooltip by direction."""
        which = "next" if properties.step > 0 else "previous"
        return f"Look through the {which} photo's camera"

    def act(self, context: bpy.types.Context) -> str:
        """Step."""
        ob = captures.step_camera(context.scene, find_root(context, self.capture), self.step)
        self.warn(captures.use_camera(context.scene, ob))
        if self.look_through:
            _look_through(context)
        return ""


class ChooseCamera(OnScene, OnCapture, bpy.types.Operator):
    """Search for a photo by name and look through its camera"""

    bl_idname = "gscore.choose_camera"
    bl_label = "Choose Photo"
    bl_property = "image"

    image: EnumProperty(
        name="Photo",
        items=_image_items,
        description="Name of the photo",
        options={"SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the search."""
        context.window_manager.invoke_search_popup(self)
        return {"RUNNING_MODAL"}

    def act(self, context: bpy.types.Context) -> str:
        """Set the camera, and look through it."""
        ob = find_camera(context, find_root(context, self.capture), self.image)
        self.warn(captures.use_camera(context.scene, ob))
        _look_through(context)
        return ""


CLASSES = (UseCamera, StepCamera, ChooseCamera)


def _views(context: bpy.types.Context) -> list[bpy.types.SpaceView3D]:
    areas = context.screen.areas if context.screen else []
    return [area.spaces.active for area in areas if area.type == "VIEW_3D"]


def _look_through(context: bpy.types.Context) -> None:
    """Turn one 3D view to the camera, unless one shows it already."""
    regions = [space.region_3d for space in _views(context)]
    if regions and all(region.view_perspective != "CAMERA" for region in regions):
        space = context.space_data
        own = getattr(space, "region_3d", None) if space and space.type == "VIEW_3D" else None
        (own or regions[0]).view_perspective = "CAMERA"
