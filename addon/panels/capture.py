"""The capture: which folder, what was found in it, and what is wrong with it."""

import bpy

from ..job import facts
from .widgets import TabPanel, rows, sentence


class CapturePanel(TabPanel, bpy.types.Panel):
    """Choose the photos"""

    bl_idname = "GSCORE_PT_capture"
    bl_label = "Capture"
    bl_order = 0

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, settings = self.layout, context.scene.gscore
        layout.prop(settings, "capture_path", text="")
        if not settings.capture_path.strip():
            text = "Choose the folder that holds the photos and their COLMAP model (sparse/0)."
            sentence(layout, context, text, icon="INFO")
            return
        found, problem = facts.capture(context.scene)
        if problem:
            sentence(layout, context, problem, icon="ERROR")
        elif found is None:
            layout.label(text="Looking into it...", icon="TIME")
        else:
            rows(layout, [(k, v) for k, v in found.lines() if k != found.kind])
            for item in found.problems:
                icon = "ERROR" if item.is_error else "INFO"
                sentence(layout, context, item.text, icon=icon)
            if found.can_train:
                layout.label(text=f"Good to train on ({found.kind})", icon="CHECKMARK")
        layout.prop(settings, "images", text="Photos in")


CLASSES = (CapturePanel,)
