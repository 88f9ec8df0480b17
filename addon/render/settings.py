"""Render settings of a scene."""

import bpy

from .picture import AUTO, OFF, ON


class RenderSettings(bpy.types.PropertyGroup):
    """`Scene.gscore_render`: settings of the engine."""

    antialias: bpy.props.EnumProperty(
        name="Anti-Aliasing",
        description="Reduce the opacity of splats smaller than a pixel, because they are drawn "
        "wider than they are",
        items=[
            (AUTO, "As Trained", "On for models trained with it, off for others"),
            (ON, "On", "For models trained with it (Mip-Splatting)"),
            (OFF, "Off", "For all other models"),
        ],
        default=AUTO,
    )
    blur_samples: bpy.props.IntProperty(
        name="Blur Samples",
        description="Number of pictures averaged for depth of field or motion blur. Use more for "
        "smoother wide blur",
        default=32,
        min=1,
        max=4096,
        soft_max=512,
    )
    live: bpy.props.BoolProperty(
        name="Live Viewport",
        description="In Rendered shading, draw splats with the graphics card until the exact "
        "picture is ready",
        default=True,
    )


PROPERTIES = ((bpy.types.Scene, "gscore_render", bpy.props.PointerProperty(type=RenderSettings)),)
