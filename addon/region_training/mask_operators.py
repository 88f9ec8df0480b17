"""Mask operators: paint, save and discard masks, and the panel for painting."""

from collections.abc import Iterable
from typing import ClassVar

import bpy
from bpy.props import EnumProperty, StringProperty

from .. import compat
from ..cameras.lookup import find_camera, find_root
from ..interface.base_operator import BaseOperator, Undoable
from ..interface.images import editor_of, fit
from ..interface.sidebar import TAB, choose_tab, close_shelf, in_turn, open_sidebar
from . import masks

_NO_BRUSH = "There is no brush yet; choose one in the image editor, then press Exclude."


class PaintMask(Undoable, bpy.types.Operator):
    """Paint a mask on the photo of the camera: erased pixels are excluded from the training"""

    bl_idname = "gscore.paint_mask"
    bl_label = "Paint Mask"

    camera: StringProperty(
        name="Camera",
        description="Object or photo; empty: the active camera, or the scene's",
        options={"SKIP_SAVE"},
    )

    def run(self, context: bpy.types.Context) -> str:
        """Make the image, and open it in paint mode."""
        camera = find_camera(context, find_root(context), self.camera)
        image = masks.make(context.scene, camera)
        area = editor_of(context, image, new_window=True)
        if area is None:
            return f"{image.name} is made; open it in an Image Editor to paint."
        area.spaces.active.ui_mode = "PAINT"
        # The sidebar has the save button; neither it nor brushes should cover the photo.
        in_turn(area, open_sidebar, choose_tab, close_shelf, fit)
        if not use_brush(context, hides=True):
            self.warn([_NO_BRUSH])
        return ""


class _OnMask(BaseOperator):
    """Base of the operators on a mask, given by name or by the image editor."""

    image: StringProperty(
        name="Image",
        description="The mask; empty: that of the image editor",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    def mask(self, context: bpy.types.Context) -> bpy.types.Image:
        """The mask to work on.

        Raises:
            ValueError: the image is not a mask.
        """
        found = bpy.data.images.get(self.image) if self.image else shown(context)
        if not masks.is_mask(found):
            raise ValueError("This image is not the mask of a photo; press Paint Mask first.")
        return found


class SaveMask(_OnMask, bpy.types.Operator):
    """Save the mask for the training. Alt: discard the unsaved strokes instead"""

    bl_idname = "gscore.save_mask"
    bl_label = "Save Mask"
    bl_options: ClassVar = {"REGISTER"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start the operator; Alt discards the mask."""
        if event.alt:
            return bpy.ops.gscore.discard_mask("EXEC_DEFAULT", image=self.mask(context).name)
        return self.execute(context)

    def run(self, context: bpy.types.Context) -> str:
        """Write it."""
        file = masks.save(context.scene, self.mask(context))
        if not context.scene.gscore.use_masks:
            self.warn(["Use Masks is off, so training ignores the mask; see Train > Options."])
        return f"Saved {file}."


class DiscardMask(Undoable, _OnMask, bpy.types.Operator):
    """Discard the strokes since the mask was saved; its file is not changed"""

    bl_idname = "gscore.discard_mask"
    bl_label = "Discard Mask"

    def run(self, context: bpy.types.Context) -> str:
        """Discard the strokes."""
        image = self.mask(context)
        name = masks.photo_name(image)
        masks.discard(image)
        return f"The painted mask of {name} was discarded; its file is unchanged."


class MaskBrush(_OnMask, bpy.types.Operator):
    """Set the brush to exclude pixels from the training, or to include them"""

    bl_idname = "gscore.mask_brush"
    bl_label = "Mask Brush"
    bl_options: ClassVar = {"REGISTER"}

    does: EnumProperty(
        name="Brush",
        description="Effect of the brush",
        items=(
            ("HIDE", "Exclude", "Exclude painted pixels from the training"),
            ("SHOW", "Include", "Include painted pixels again"),
        ),
    )

    def run(self, context: bpy.types.Context) -> None:
        """Set it."""
        if not use_brush(context, hides=self.does == "HIDE"):
            raise ValueError(_NO_BRUSH)


class MaskPanel(bpy.types.Panel):
    """Painting a mask on a photo"""

    bl_idname = "GSCORE_PT_mask"
    bl_label = "Mask of a Photo"
    bl_space_type = "IMAGE_EDITOR"
    bl_region_type = "UI"
    bl_category = TAB

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A mask is shown."""
        return masks.is_mask(shown(context))

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        image = shown(context)
        layout.label(text=masks.photo_name(image), icon="IMAGE_ALPHA")
        row = layout.row(align=True)
        row.operator("gscore.mask_brush", text="Exclude").does = "HIDE"
        row.operator("gscore.mask_brush", text="Include").does = "SHOW"
        row = layout.row(align=True)
        row.operator("gscore.save_mask", icon="FILE_TICK")
        row.operator("gscore.discard_mask", text="", icon="X")
        if masks.is_unsaved(image):
            layout.label(text="Not saved yet", icon="INFO")


def shown(context: bpy.types.Context) -> bpy.types.Image | None:
    """The image of the context's image editor, else of the first image editor."""
    space = getattr(context, "space_data", None)
    if space is not None and space.type == "IMAGE_EDITOR":
        return space.image
    return next(iter(_images(context)), None)


def use_brush(context: bpy.types.Context, *, hides: bool) -> bool:
    """Set the brush of image painting to erase or add alpha; return whether there is a brush.

    Builds of Blender without its assets have none.
    """
    brush = compat.tool_settings(context).image_paint.brush
    if brush is None:
        return False
    brush.blend = "ERASE_ALPHA" if hides else "ADD_ALPHA"
    return True


def _images(context: bpy.types.Context) -> Iterable[bpy.types.Image]:
    areas = (area for window in context.window_manager.windows for area in window.screen.areas)
    spaces = (area.spaces.active for area in areas if area.type == "IMAGE_EDITOR")
    return (space.image for space in spaces if masks.is_mask(space.image))
