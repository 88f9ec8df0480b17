"""An animated Blender camera into a transforms.json: a camera for each frame of the scene."""

from dataclasses import replace
from pathlib import Path

import bpy

from ..core import atomic_write
from .export_colmap import collect
from .export_transforms import transforms_text


def export_path(
    path: str | Path,
    camera: bpy.types.Object,
    scene: bpy.types.Scene,
    *,
    root: bpy.types.Object | None = None,
) -> int:
    """Write where a camera stands, and its lens, at each frame of the scene's range.

    Every `frame_step`-th frame is written, as a render of the animation would draw them. The scene
    stands at its own frame again afterwards. Depth of field, motion blur and clipping distances
    have no place in the file.

    Args:
        path: The file to write.
        camera: A perspective camera; its lens, sensor and shift may be animated.
        scene: Gives range, resolution and pixel aspect.
        root: A capture's empty, whose world is written; None: Blender's world.

    Returns:
        How many frames were written.

    Raises:
        GsError: the file cannot be written.
        ValueError: the camera is orthographic, panoramic or sheared at some frame.
    """
    here, views = (scene.frame_current, scene.frame_subframe), []
    try:
        for number in range(scene.frame_start, scene.frame_end + 1, scene.frame_step):
            scene.frame_set(number)
            (view,) = collect([camera], scene, root, bpy.context.evaluated_depsgraph_get())
            views.append(replace(view, name=f"frame_{number:06d}.png", photo=None))
    finally:
        scene.frame_set(here[0], subframe=here[1])
    atomic_write(path, transforms_text(views, Path(path).parent).encode())
    return len(views)
