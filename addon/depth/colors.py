"""Depth colors: cameras of a capture coloured by the state of their depth maps."""

import bpy

from ..cameras.camera_colors import ShowsColors, hide, mark_of, marks, own_cameras, set_color, take
from ..cameras.lookup import panel_root
from ..capture.depth_maps import ACCEPTED, MISSING, REFUSED, DepthReport
from ..interface.windows import push_undo
from ..process import poll_timer
from . import predict_depth

PALETTE = {
    ACCEPTED: (0.1, 0.8, 0.45, 1.0),
    REFUSED: (1.0, 0.3, 0.1, 1.0),
    MISSING: (0.6, 0.6, 0.6, 1.0),
}
"""Linear RGBA, distinct also for red-green colour blindness."""
_followed: dict[str, DepthReport] = {}
"""The last report of each scene, by the scene's name."""


def show(root: bpy.types.Object, report: DepthReport) -> int:
    """Color the cameras of a capture by a report; return the number of cameras in the report.

    Views that were not compared yet keep their color.
    """
    known = 0
    for ob in own_cameras(root):
        verdict = _verdict(ob, report)
        if verdict is None:
            take(ob)
        else:
            set_color(ob, verdict, PALETTE[verdict])
            known += 1
    return known


def matches(root: bpy.types.Object, report: DepthReport) -> bool:
    """True if the colors of a capture's cameras match a report."""
    return all(mark_of(ob) == (_verdict(ob, report) or "") for ob in own_cameras(root))


def shown(root: bpy.types.Object) -> bool:
    """True if cameras of a capture are colored by their maps."""
    return not marks(root).isdisjoint(PALETTE)


def follow() -> bool:
    """Update the colors of cameras whose report has changed; True if there were any."""
    if bpy.app.is_job_running("RENDER"):
        return False
    changed = False
    for scene in bpy.data.scenes:
        report = predict_depth.report(scene)
        if report is None or report is _followed.get(scene.name):
            continue
        _followed[scene.name] = report
        root = panel_root(scene)  # the capture of the report
        if root is not None and shown(root) and not matches(root, report):
            show(root, report)
            push_undo("Color Cameras")
            changed = True
    return changed


def _verdict(ob: bpy.types.Object, report: DepthReport) -> str | None:
    """The state of a camera's view in a report, if that state has a color."""
    row = report.by_view.get(str(ob.get("gs_image", "")))
    return row.verdict if row is not None and row.verdict in PALETTE else None


class ColorCameras(ShowsColors, bpy.types.Operator):
    """Color the cameras by their depth maps: green accepted, red refused, gray without a map"""

    bl_idname = "gscore.color_cameras"
    bl_label = "Color Cameras"

    def run(self, context: bpy.types.Context) -> str:
        """Color the cameras, or restore their colors."""
        scene = context.scene
        root = panel_root(scene)
        if root is None:
            raise ValueError("The capture is not imported. Use Import Cameras first.")
        if not own_cameras(root):
            raise ValueError(f"{root.name} has no cameras that can be colored: make them local.")
        if not self.show:
            hide(root)
            return ""
        report = predict_depth.report(scene)
        if report is None:
            raise ValueError("There is no depth report yet; use Check Maps.")
        known = show(root, report)
        if not known:
            raise ValueError(f"The depth report has no camera of {root.name}; use Check Maps.")
        return f"Colored {known} cameras of {root.name} by their depth maps."


_POLLER = poll_timer.Poller(follow)
APPENDED = ((poll_timer.POLLERS, _POLLER),)


def on_unregister() -> None:
    """Stop following reports; colors stay in the file until the add-on removes them."""
    _followed.clear()
