"""Brush settings of this Blender session, stored by window, so that undo of a stroke keeps them."""

import bpy
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    PointerProperty,
)

from .brush import CLONE, COLOR, OPACITY, SELECT, Brush

LARGEST_RADIUS = 2000.0
"""Pixels."""
FRONT_ONLY = "Leave out splats with a center behind the visible surface of the object"
"""Description of the setting Front Only."""
_DOES = [
    (COLOR, "Color", "Paint a color; view-dependent colors are kept", "BRUSH_DATA", 0),
    (OPACITY, "Opacity", "Paint an opacity; 0 erases", "MOD_OPACITY", 1),
    (SELECT, "Select", "Select or deselect splats", "RESTRICT_SELECT_OFF", 2),
    (CLONE, "Clone", "Copy splats from around the 3D cursor", "DUPLICATE", 3),
]


class BrushProperties:
    """Brush properties, shared by the session settings and the operator for scripts."""

    does: EnumProperty(name="Brush", description="Effect of the brush", items=_DOES)
    strength: FloatProperty(
        name="Strength",
        description="Blending weight of the color or opacity in one stroke; opacity of copies",
        subtype="FACTOR",
        min=0.0,
        max=1.0,
        default=1.0,
    )
    hardness: FloatProperty(
        name="Hardness",
        description="Share of the radius with full strength; the brush fades outside of it",
        subtype="FACTOR",
        min=0.0,
        max=1.0,
        default=0.5,
    )
    color: FloatVectorProperty(
        name="Color",
        description="Color to paint",
        subtype="COLOR_GAMMA",
        min=0.0,
        max=1.0,
        default=(0.8, 0.1, 0.1),
    )
    opacity: FloatProperty(
        name="Opacity",
        description="Opacity to paint; 0 erases splats",
        subtype="FACTOR",
        min=0.0,
        max=1.0,
        default=0.0,
    )
    front_only: BoolProperty(name="Front Only", description=FRONT_ONLY, default=True)
    only_selected: BoolProperty(
        name="Only Selected", description="Paint only splats that are selected in Edit Mode"
    )

    def brush(self, *, inverted: bool) -> Brush:
        """The brush of these settings."""
        return Brush(
            radius=self.radius,
            does=self.does,
            strength=self.strength,
            hardness=self.hardness,
            color=tuple(self.color),
            opacity=self.opacity,
            inverted=inverted,
        )


class BrushSettings(BrushProperties, bpy.types.PropertyGroup):
    """The brush of Paint Splats."""

    radius: FloatProperty(
        name="Radius",
        description="Radius of the brush in pixels",
        subtype="PIXEL",
        min=1.0,
        max=LARGEST_RADIUS,
        soft_max=500.0,
        default=50.0,
        precision=0,
    )


PROPERTIES = ((bpy.types.WindowManager, "gscore_paint", PointerProperty(type=BrushSettings)),)
