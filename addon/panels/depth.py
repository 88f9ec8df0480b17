"""Depth maps of the capture: what there is, and what becomes of it."""

from typing import ClassVar

import bpy

from .widgets import TabPanel, found, rows, sentence


class DepthPanel(TabPanel, bpy.types.Panel):
    """Depth maps"""

    bl_idname = "GSCORE_PT_depth"
    bl_label = "Depth"
    bl_order = 2
    bl_options: ClassVar = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, facts = self.layout, found(context)
        if facts is None or not facts.kind:
            layout.label(text="Choose a capture first", icon="INFO")
            return
        maps = f"{facts.depths} of {facts.photos} photos" if facts.depths else "none (depths/)"
        scales = f"{facts.depth_params} entries" if facts.depth_params else "none"
        rows(layout, [("Depth maps", maps), ("Scales", scales)])
        if facts.depths:
            layout.prop(context.scene.gscore, "depth_mode")
            return
        text = (
            "Depth maps help where photos are few. `gscore depth` makes them with a network; see "
            "docs/depth.md."
        )
        sentence(layout, context, text, icon="INFO")


CLASSES = (DepthPanel,)
