"""Capture panel: the folder, its photos and cameras, and problems with them."""

import bpy

from ..capture.inspection import ShownFacts
from ..sequence import train_sequence as sequence
from ..sfm import find_cameras
from ..training import facts, operators
from .manual import draw_help
from .widgets import TabPanel, has_python, rows, sentence


class CapturesMenu(bpy.types.Menu):
    """Choose a capture of this scene"""

    bl_idname = "GSCORE_MT_captures"
    bl_label = "Captures"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the menu."""
        there = operators.known(context.scene)
        for path in there:
            choose = self.layout.operator(
                "gscore.choose_capture", text=operators.label(path, there)
            )
            choose.path = str(path)


class CapturePanel(TabPanel, bpy.types.Panel):
    """Folder of photos, or a video"""

    bl_idname = "GSCORE_PT_capture"
    bl_label = "Capture"
    bl_order = 0

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        """Draw the help button at the right of the header."""
        draw_help(self.layout)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, settings = self.layout, context.scene.gscore
        row = layout.row(align=True)
        row.prop(settings, "capture_path", text="")
        if len(operators.known(context.scene)) > 1:
            row.menu(CapturesMenu.bl_idname, text="", icon="DOWNARROW_HLT")
        row.operator("gscore.choose_video", text="", icon="FILE_MOVIE")
        if not settings.capture_path.strip():
            text = "Choose a folder of photos or a video, or drop a video on the 3D view."
            sentence(layout, text, icon="INFO")
            return
        found, problem = facts.capture(context.scene)
        frames = sequence.frames_of(context.scene)[0]
        if frames and (problem or (found is not None and not found.can_train)):
            text = f"{len(frames):,} captures, one per frame: train them in Sequence of Captures."
            sentence(layout, text, icon="INFO")
            return
        if problem:
            sentence(layout, problem, icon="ERROR")
        elif found is None:
            layout.label(text="Reading the folder...", icon="TIME")
        else:
            rows(layout, [(k, v) for k, v in found.lines() if k != found.kind])
            for item in found.problems:
                icon = "ERROR" if item.is_error else "INFO"
                sentence(layout, item.text, icon=icon)
            if found.can_train:
                layout.label(text=f"Ready to train ({found.kind})", icon="CHECKMARK")
            if found.bare:
                draw_search(layout, context, found)
                return
        layout.prop(settings, "images")


def draw_search(layout: bpy.types.UILayout, context: bpy.types.Context, found: ShownFacts) -> None:
    """Draw the button that finds cameras, or the reason why it cannot start yet."""
    job = find_cameras.job_of(context.scene)
    if job is not None and job.busy:
        layout.label(text="Finding cameras; see Progress", icon="TIME")
        return
    what = "A video" if found.photos == 0 else "Photos"
    text = f"{what} without cameras. Find Cameras creates a capture in the same parent folder."
    sentence(layout, text, icon="INFO")
    if not has_python(layout):
        return
    big = layout.column()
    big.scale_y = 1.4
    big.enabled = not any(problem.is_error for problem in found.problems)
    big.operator("gscore.find_cameras", icon="VIEW_CAMERA")
