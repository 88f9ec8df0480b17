"""Colors of a capture's cameras by what became of their depth maps.

The color is the camera object's own, and the viewport's drawing of it is `overlay`. What the
user had there is kept in a custom property and comes back.
"""

from typing import ClassVar

import bpy
from bpy.props import BoolProperty

from ..cameras.lookup import panel_root
from ..cameras.objects import cameras_of
from ..capture.depth_maps import ACCEPTED, MISSING, REFUSED, DepthReport
from ..interface import undo
from ..interface.operators import Acting
from ..process import beat
from . import work

VERDICT, COLORS = "gs_depth", "gs_depth_colors"
"""Custom properties of a colored camera: the verdict; the color it had and the one it was given,
RGBA each."""
PALETTE = {
    ACCEPTED: (0.1, 0.8, 0.45, 1.0),
    REFUSED: (1.0, 0.3, 0.1, 1.0),
    MISSING: (0.6, 0.6, 0.6, 1.0),
}
"""Linear RGBA; told apart by people who confuse red and green, too."""
_TOLERANCE = 1e-5

_followed: dict[str, DepthReport] = {}
"""The last report of each scene, by the scene's name."""


def show(root: bpy.types.Object, report: DepthReport) -> int:
    """Color the cameras of a capture by a report; how many of them it knows.

    Cameras of linked files, overrides, which keep no custom properties, and views that were not
    compared yet keep their color.
    """
    known = 0
    for ob in _own_cameras(root):
        verdict = _verdict(ob, report)
        if verdict is None:
            _remove(ob)
        else:
            _give(ob, verdict)
            known += 1
    return known


def matches(root: bpy.types.Object, report: DepthReport) -> bool:
    """Whether the cameras of a capture show what a report says."""
    return all(ob.get(VERDICT) == _verdict(ob, report) for ob in _own_cameras(root))


def hide(root: bpy.types.Object) -> None:
    """Give the cameras of a capture the colors back that they had."""
    for ob in _own_cameras(root):
        _remove(ob)


def shown(root: bpy.types.Object) -> bool:
    """Whether cameras of a capture are colored."""
    return any(VERDICT in ob for ob in root.children_recursive)


def follow() -> bool:
    """Color cameras anew where another report is known by now; whether there were any."""
    if bpy.app.is_job_running("RENDER"):
        return False
    changed = False
    for scene in bpy.data.scenes:
        report = work.report(scene)
        if report is None or report is _followed.get(scene.name):
            continue
        _followed[scene.name] = report
        root = panel_root(scene)  # whose maps the report is about
        if root is not None and shown(root) and not matches(root, report):
            show(root, report)
            undo.push("Color Cameras")
            changed = True
    return changed


def _own_cameras(root: bpy.types.Object) -> list[bpy.types.Object]:
    return [ob for ob in cameras_of(root) if ob.library is None and ob.override_library is None]


def _verdict(ob: bpy.types.Object, report: DepthReport) -> str | None:
    """What a report says of a camera's view, if that has a color."""
    row = report.by_view.get(str(ob.get("gs_image", "")))
    return row.verdict if row is not None and row.verdict in PALETTE else None


def _give(ob: bpy.types.Object, verdict: str) -> None:
    _remove(ob)
    own = [float(v) for v in ob.color]
    ob.color = PALETTE[verdict]
    ob[VERDICT], ob[COLORS] = verdict, [*own, *(float(v) for v in ob.color)]


def _remove(ob: bpy.types.Object) -> None:
    """A color that the user has given it since stays."""
    if VERDICT not in ob:
        return
    kept = [float(v) for v in ob.get(COLORS, ())]
    now = [float(v) for v in ob.color]
    if len(kept) == 8 and all(abs(a - b) < _TOLERANCE for a, b in zip(now, kept[4:], strict=True)):
        ob.color = kept[:4]
    del ob[VERDICT]
    if COLORS in ob:
        del ob[COLORS]


class ColorCameras(Acting, bpy.types.Operator):
    """Color the cameras by their depth maps: green accepted, red refused, grey without a map"""

    bl_idname = "gscore.color_cameras"
    bl_label = "Color Cameras"
    bl_options: ClassVar = {"REGISTER", "UNDO"}

    show: BoolProperty(
        name="Show",
        description="Color the cameras; else give them their own colors back",
        default=True,
        options={"SKIP_SAVE"},
    )

    def act(self, context: bpy.types.Context) -> str:
        """Color, or take the colors away."""
        scene = context.scene
        root = panel_root(scene)
        if root is None:
            raise ValueError("The capture is not imported. Use Import Cameras first.")
        if not _own_cameras(root):
            raise ValueError(f"{root.name} has no cameras that can be colored: make them local.")
        if not self.show:
            hide(root)
            return ""
        report = work.report(scene)
        if report is None:
            raise ValueError("There is no depth report yet; Check Maps makes one.")
        known = show(root, report)
        if not known:
            raise ValueError(f"The depth report knows no camera of {root.name}; Check Maps.")
        return f"{known} cameras of {root.name} show their depth maps."


CLASSES = (ColorCameras,)
_FOLLOWER = beat.Follower(follow)


def on_register() -> None:
    """Follow reports."""
    beat.FOLLOWERS.append(_FOLLOWER)


def on_unregister() -> None:
    """Follow them no more; colors stay in the file and can be removed when the add-on is back."""
    beat.FOLLOWERS.remove(_FOLLOWER)
    _followed.clear()
