"""View context: shading of a 3D view, and objects other than splats in it; for draw handlers."""

import bpy
import numpy as np

from ..compat import rec709_to_scene
from ..render.engine import NAME
from ..render.operators import changes_colors
from ..splats.objects import is_splats
from .clip import Cuts

_HIDES = {"MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME"}
"""Object types that may hide splats."""


def is_own(context: bpy.types.Context) -> bool:
    """Whether the view is in Rendered shading of the add-on's engine."""
    return context.space_data.shading.type == "RENDERED" and context.scene.render.engine == NAME


def keeps_colors(context: bpy.types.Context) -> bool:
    """Whether a view shows decoded sRGB values in its picture unchanged."""
    scene = context.scene
    plain = context.space_data.shading.type == "SOLID" or not changes_colors(scene)
    device = scene.display_settings.display_device
    return plain and device == "sRGB" and np.allclose(rec709_to_scene(), np.eye(3), atol=1e-6)


def is_hidden_by_others(context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether any object may hide splats; reading depths means waiting for the card."""
    if is_own(context):
        return False  # it draws no meshes, though Blender adds their depths for its lines
    if context.space_data.overlay.show_overlays:
        return True  # lines: wires, bones, boxes of splats, the grid
    return any(ob.type in _HIDES and _has_surface(ob) for ob in depsgraph.objects)


def has_lines_in_front(context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether lines may be drawn over everything (In Front)."""
    if is_own(context) or not context.space_data.overlay.show_overlays:
        return False
    return any(ob.show_in_front for ob in depsgraph.objects)


def _has_surface(ob: bpy.types.Object) -> bool:
    if is_splats(ob):
        return ob.original.gscore.display in {"POINTS", "ELLIPSOIDS", "SOFT", "NATIVE"}
    return ob.display_type in {"SOLID", "TEXTURED"}


def cuts_of(context: bpy.types.Context) -> Cuts:
    """The clipping of a view, as for meshes; the engine's shading has no far end."""
    space, region = context.space_data, context.region_data
    if not region.use_clip_planes or space.shading.type != "SOLID":
        return Cuts(far=not is_own(context))
    planes = np.array(region.clip_planes, np.float64)[: 4 if region.use_box_clip else 6]
    return Cuts(far=True, planes=planes)
