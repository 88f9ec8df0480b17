"""World colour: the uniform background over which splats are rendered."""

import bpy
import numpy as np

from ..compat import rec709_to_scene, world_nodes
from ..srgb import encode


def world_of(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> bpy.types.World | None:
    """The world that a view layer shows; None: none."""
    return (layer.world_override or scene.world) if layer.use_sky else None


def world_light(world: bpy.types.World | None) -> tuple[np.ndarray, str]:
    """Scene-linear colour of the background [3], and a warning if the world is not uniform."""
    if world is None:
        return np.zeros(3), ""
    tree = world_nodes(world)
    if tree is None:
        return np.array(world.color), ""
    node = next((n for n in tree.nodes if n.type == "BACKGROUND"), None)
    if node is not None and not any(s.is_linked for s in node.inputs):
        return np.array(node.inputs[0].default_value[:3]) * node.inputs[1].default_value, ""
    return (
        np.array(world.color),
        f"World {world.name} is not one uniform color: its viewport color is used. To render "
        f"splats over the world, turn on Transparent and composite them.",
    )


def light_of(depsgraph: bpy.types.Depsgraph) -> np.ndarray:
    """Scene-linear colour [3] of the background of a depsgraph."""
    return world_light(world_of(depsgraph.scene, depsgraph.view_layer_eval))[0]


def background_of(light: np.ndarray) -> tuple[float, float, float]:
    """sRGB values of a scene-linear colour."""
    rec709 = np.linalg.solve(rec709_to_scene(), np.asarray(light, np.float64))
    r, g, b = (float(v) for v in encode(rec709))
    return r, g, b
