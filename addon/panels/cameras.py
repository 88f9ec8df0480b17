"""Capture panel: the folder, its photos and cameras, and problems with them; cameras panel: import,
walk through, align and export the capture's cameras.
"""

from typing import ClassVar

import bpy

from .. import stored_paths
from ..cameras import undistort_jobs
from ..cameras.captures import changeable
from ..cameras.objects import cameras_of, points_of
from ..capture.inspection import ShownFacts
from ..interface.base_operator import Condition
from ..region_training import masks
from ..sequence import train_sequence as sequence
from ..sfm import find_cameras
from ..training import facts, operators
from .manual import draw_help
from .widgets import TabPanel, found, has_python, root, rows, sentence


class CamerasPanel(TabPanel, bpy.types.Panel):
    """Cameras, photos and points"""

    bl_idname = "GSCORE_PT_cameras"
    bl_label = "Cameras"
    bl_order = 1

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, empty = self.layout, root(context)
        if empty is None:
            if not context.scene.gscore.capture_path.strip():
                layout.label(text="Choose a capture first", icon="INFO")
                return
            draw_import(layout, context)
            sentence(layout, "Optional: training works without an import.")
            return
        cameras, points = cameras_of(empty), points_of(empty)
        count = f"{len(points.data.vertices):,}" if points else "none"
        rows(layout, [("Cameras", str(len(cameras))), ("Points", count)])
        draw_import(layout, context, empty)
        row = layout.row(align=True)
        back = row.operator("gscore.step_camera", text="", icon="TRIA_LEFT")
        camera = context.scene.camera
        name = str(camera.get("gs_image", camera.name)) if camera else "No camera"
        use = row.operator("gscore.use_camera", text=name, icon="VIEW_CAMERA")
        choose = row.operator("gscore.choose_camera", text="", icon="VIEWZOOM")
        forth = row.operator("gscore.step_camera", text="", icon="TRIA_RIGHT")
        back.step, forth.step = -1, 1
        _aim(empty, back, use, choose, forth)
        photos, row = context.scene.gscore_photos, layout.row(align=True)
        row.enabled = bool(changeable(context.scene))
        row.prop(photos, "shown")
        opacity = row.row(align=True)
        opacity.enabled = photos.shown
        opacity.prop(photos, "opacity")
        draw_undistortion(layout, empty, cameras)
        draw_mask(layout, context, camera if camera in cameras else None)
        if camera is not None and camera not in cameras:
            sentence(layout, "The scene camera does not belong to the capture.")


def draw_import(
    layout: bpy.types.UILayout, context: bpy.types.Context, there: bpy.types.Object | None = None
) -> None:
    """Draw the button that imports cameras or updates imported ones."""
    row = layout.row()
    if there is None:
        facts = found(context)
        row.enabled = facts is not None and bool(facts.kind)
        row.operator("gscore.import_cameras", icon="CAMERA_DATA")
        return
    again = row.operator("gscore.import_cameras", text="Import Cameras Again", icon="FILE_REFRESH")
    again.capture = there.name
    if not context.scene.gscore.capture_path.strip():
        again.directory = stored_paths.read(there, stored_paths.SOURCE)
        again.images = str(there.get("gs_images", "images"))


def draw_undistortion(
    layout: bpy.types.UILayout,
    empty: bpy.types.Object,
    cameras: list[bpy.types.Object],
) -> None:
    """Draw the progress of undistortion, or a button if undistorted photos are missing."""
    queue = undistort_jobs.QUEUE
    if queue.busy:
        row, total = layout.row(align=True), max(queue.total, 1)
        text = f"Undistorting photos: {queue.done} of {queue.total}"
        row.progress(factor=queue.done / total, text=text)
        row.operator("gscore.stop_straightening", text="", icon="X")
        return
    lack = undistort_jobs.MISSING_COPIES.of(empty, cameras)
    for problem in undistort_jobs.problems_of(lack)[:1]:
        sentence(layout, problem, icon="ERROR")
    if lack.copies:
        button = layout.operator("gscore.straighten_photos", icon="IMAGE_DATA")
        button.capture = empty.name


def draw_mask(
    layout: bpy.types.UILayout, context: bpy.types.Context, camera: bpy.types.Object | None
) -> None:
    """Draw the button that paints a mask on the camera's photo, and unsaved masks."""
    row = layout.row(align=True)
    row.enabled = camera is not None
    row.operator("gscore.paint_mask", icon="BRUSH_DATA").camera = (
        "" if camera is None else camera.name
    )
    for image in masks.unsaved_of(root(context)):
        row = layout.row(align=True)
        row.label(text=masks.photo_name(image), icon="IMAGE_ALPHA")
        row.operator("gscore.save_mask", text="Save").image = image.name
        row.operator("gscore.discard_mask", text="", icon="X").image = image.name


class AlignmentPanel(TabPanel, bpy.types.Panel):
    """Up direction, ground and scale of the capture"""

    bl_idname = "GSCORE_PT_alignment"
    bl_label = "Alignment and Export"
    bl_parent_id = "GSCORE_PT_cameras"
    bl_options: ClassVar = {"DEFAULT_CLOSED"}
    needs = Condition(lambda context: root(context) is not None)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        row = layout.row(align=True)
        align = row.operator_menu_enum("gscore.align_capture", "up", text="Align to Ground")
        flip = row.operator("gscore.flip_up")
        row = layout.row(align=True)
        extent = row.operator("gscore.set_extent")
        reset = row.operator("gscore.reset_alignment", text="Reset")
        relink = layout.operator("gscore.relink_capture", icon="FILE_REFRESH")
        export = layout.operator("gscore.export_cameras", icon="EXPORT")
        row = layout.row(align=True)
        path = row.operator("gscore.export_camera_path", icon="CAMERA_DATA")
        back = row.operator("gscore.import_camera_path", text="", icon="IMPORT")
        _aim(root(context), align, flip, extent, reset, relink, export, path, back)


def _aim(empty: bpy.types.Object, *buttons: bpy.types.OperatorProperties) -> None:
    """Set operators to the panel's capture, independent of the active object."""
    for button in buttons:
        button.capture = empty.name


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
