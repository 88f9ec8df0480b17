"""Region training settings of a scene."""

import bpy

from ..core import TrainConfig
from ..training.properties import declared


class RegionSettings(bpy.types.PropertyGroup):
    """Region training settings of a scene, `Scene.gscore_steer`."""

    region_steps: declared(
        TrainConfig(),
        "iterations",
        "Steps",
        default=2000,
        soft_min=200,
        soft_max=10_000,
        description="Training steps for a region, one photo each",
    )


PROPERTIES = ((bpy.types.Scene, "gscore_steer", bpy.props.PointerProperty(type=RegionSettings)),)
