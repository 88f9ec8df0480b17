"""Display settings of a splat object: properties copied to the inputs of its display modifier."""

import time
from contextlib import suppress

import bpy
from bpy.app.handlers import persistent

from .. import attributes, compat
from ..nodes import display
from ..nodes.colors import MODES as COLOR_MODES
from ..nodes.graph import is_of_another_blender
from ..process.incremental_tasks import BUDGET, Steps
from . import live_display
from .filters import BOX, SPHERE

_RENDERED_AS = "Native Splats" if compat.splat_cloud_type() else "Soft Splats"
_DISPLAYS = [
    (
        "SPLATS",
        "Splats",
        "Drawn in full color by the graphics card in every viewport; EEVEE and Cycles render "
        f"{_RENDERED_AS}",
        4,
    ),
    (
        "POINTS",
        "Points",
        "Draw a small ball of equal size for each splat; fast, useful for selecting",
        0,
    ),
    ("ELLIPSOIDS", "Ellipsoids", "Draw each splat as an opaque ellipsoid", 1),
    (
        "SOFT",
        "Soft Splats",
        "Draw ellipsoids that fade out like splats, in Material Preview and Rendered shading, "
        "with the colors as seen from the scene camera, also in other views. In Cycles, raise "
        "Light Paths > Transparent to 256",
        2,
    ),
]
_NATIVE = (
    "NATIVE",
    "Native Splats",
    "Blender's own Gaussian splats, in full color, in EEVEE and Cycles",
    3,
)
"""Its number is the index in `display.MODES`, which files store."""
_COLORS = [
    (
        "COLOR",
        "Color",
        "Color without view dependence; Soft Splats: as seen from the scene camera",
    ),
    ("OPACITY", "Opacity", "From 0 (dark blue) to 1 (yellow)"),
    ("SIZE", "Size", "Largest standard deviation, from small (dark blue) to large (yellow)"),
    ("ANISOTROPY", "Anisotropy", "Longest axis by shortest, from 1 (dark blue) to 100 (yellow)"),
    ("SH_ENERGY", "SH Energy", "View dependence of the color, from none (dark blue) to yellow"),
    ("DEPTH", "Depth", "Distance from the scene camera, from near (dark blue) to far (yellow)"),
]
_SHAPES = [
    (BOX, "Box", "Inside the crop object's bounding box"),
    (SPHERE, "Ellipsoid", "Inside the ellipsoid that touches the sides of the bounding box"),
]


_KEPT = {"LIBRARY_OVERRIDABLE"}
"""Options of properties that a library override keeps."""


def _update(self: "SplatSettings", context: bpy.types.Context) -> None:
    apply(self.id_data)


def _number(name: str, description: str, default: float, **more: object) -> bpy.props.FloatProperty:
    return bpy.props.FloatProperty(
        name=name,
        description=description,
        default=default,
        min=0.0,
        update=_update,
        override=_KEPT,
        **more,
    )


class SplatSettings(bpy.types.PropertyGroup):
    """Display and filters of one splat object."""

    display: bpy.props.EnumProperty(
        name="Display",
        description="Display of splats in the viewport and by EEVEE and Cycles",
        items=[*_DISPLAYS, _NATIVE] if compat.splat_cloud_type() else _DISPLAYS,
        default="POINTS",
        update=_update,
        override=_KEPT,
    )
    colour_by: bpy.props.EnumProperty(
        name="Color By",
        description="Quantity shown by the colors",
        items=_COLORS,
        update=_update,
        override=_KEPT,
    )
    point_size: _number(
        "Point Radius",
        "Radius of a point, in units of the splats before the object's scale",
        0.01,
        precision=4,
        soft_max=1.0,
    )
    ellipsoid_size: _number(
        "Ellipsoid Size", "Half axes of an ellipsoid, in standard deviations", 1.5, soft_max=3.0
    )
    opacity_min: _number(
        "Minimum Opacity", "Hide splats with a lower opacity, 0 to 1", 0.0, max=1.0
    )
    size_min: _number(
        "Minimum Size",
        "Hide splats whose largest standard deviation is below this, in units of the splats "
        "before the object's scale",
        0.0,
        precision=5,
    )
    size_max: _number(
        "Maximum Size",
        "Hide splats whose largest standard deviation is above this, in units of the splats "
        "before the object's scale; 0 for no limit",
        0.0,
        precision=5,
    )
    crop_object: bpy.props.PointerProperty(
        name="Crop Object",
        description="Show only splats whose center is inside this object's bounds. The bounds of "
        "an empty are one unit to each side",
        type=bpy.types.Object,
        poll=lambda settings, ob: (
            ob != settings.id_data and ob.type in {"MESH", "EMPTY"} and not ob.get("gs_kind")
        ),
        update=_update,
        override=_KEPT,
    )
    crop_shape: bpy.props.EnumProperty(
        name="Crop Shape",
        description="Shape of the crop",
        items=_SHAPES,
        update=_update,
        override=_KEPT,
    )
    crop_invert: bpy.props.BoolProperty(
        name="Invert",
        description="Show only splats outside the crop",
        update=_update,
        override=_KEPT,
    )
    light: bpy.props.FloatProperty(
        name="Light",
        description="Light on the splats: 0, that of the photos; 1, the scene's lamps and world. "
        "Relight Splats prepares it",
        default=0.0,
        min=0.0,
        max=1.0,
        subtype="FACTOR",
        update=_update,
        override=_KEPT,
    )
    apply_filters_to_render: bpy.props.BoolProperty(
        name="Filters in Render",
        description="Also hide filtered splats in renders of the Gaussian Splats engine",
        default=True,
        override=_KEPT,
    )


def apply(ob: bpy.types.Object) -> None:
    """Copy the object's settings to its display modifier, if it has one."""
    modifier = display.modifier_of(ob)
    if modifier is None:
        return
    settings = ob.gscore
    mode = settings.display or "SOFT"  # empty: a display that only newer Blender versions have
    if mode in {"SPLATS", "NATIVE"} or is_of_another_blender(modifier.node_group):
        modifier.node_group = display.group()  # one from a file may lack this display
    if mode == "SPLATS" and live_display.SESSION.problem:
        mode = "POINTS"
    data = ob.data  # may be of a file from an older version of the add-on
    if isinstance(data, bpy.types.Mesh) and data.is_editable and not data.is_editmode:
        attributes.leave_points_unselected(data)
    values = {
        "Display": display.MODES.index(mode),
        "Color By": COLOR_MODES.index(settings.colour_by),
        "Point Radius": settings.point_size,
        "Ellipsoid Size": settings.ellipsoid_size,
        "Opacity Minimum": settings.opacity_min,
        "Size Minimum": settings.size_min,
        "Size Maximum": settings.size_max,
        "Use Crop": settings.crop_object is not None,
        "Crop Object": settings.crop_object,
        "Crop Sphere": settings.crop_shape == SPHERE,
        "Crop Invert": settings.crop_invert,
    }
    for name, value in values.items():
        compat.set_modifier_input(modifier, name, value)
    with suppress(KeyError):  # a group from an older file, which Restore Display updates
        compat.set_modifier_input(modifier, "Light", settings.light)


FILTERS = ("opacity_min", "size_min", "size_max", "crop_object", "crop_shape", "crop_invert")


def reset_filters(ob: bpy.types.Object) -> None:
    """Show all splats of an object again."""
    for name in FILTERS:
        ob.gscore.property_unset(name)
    apply(ob)


def building() -> Steps[None]:
    """Build the display node groups of a file, one per step."""
    until = time.perf_counter() + BUDGET
    for build in display.builders():
        build()
        if time.perf_counter() > until:
            yield "Preparing the display of splats"
            until = time.perf_counter() + BUDGET


def attach(ob: bpy.types.Object) -> bpy.types.NodesModifier:
    """Add the display modifier to a splat object, or update the node group of an existing one."""
    modifier = display.modifier_of(ob) or ob.modifiers.new(display.NAME, "NODES")
    modifier.node_group = display.group()
    apply(ob)
    return modifier


@persistent
def _renew(*_: object) -> None:
    """Replace displays of files from other Blender versions by supported ones."""
    for ob in bpy.data.objects:
        modifier = display.modifier_of(ob) if ob.library is None else None
        if modifier is not None and is_of_another_blender(modifier.node_group):
            apply(ob)


PROPERTIES = (
    (bpy.types.Object, "gscore", bpy.props.PointerProperty(type=SplatSettings, override=_KEPT)),
)
HANDLERS = {"load_post": _renew}
