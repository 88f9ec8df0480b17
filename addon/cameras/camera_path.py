"""An animated Blender camera into a file of a camera path: a camera for each frame."""

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

from ..core import Cameras, atomic_write, write_cameras, write_nerfstudio_path
from .export_transforms import transforms_text
from .export_views import ExportView, collect

CAMERAS, TRANSFORMS, NERFSTUDIO = "CAMERAS", "TRANSFORMS", "NERFSTUDIO"
"""Kinds of files: a cameras.json, a transforms.json, nerfstudio's camera_path.json."""


def export_path(
    path: str | Path,
    camera: bpy.types.Object,
    scene: bpy.types.Scene,
    *,
    root: bpy.types.Object | None = None,
    kind: str = CAMERAS,
) -> int:
    """Write where a camera stands, and its lens, at each frame of the scene's range.

    Every `frame_step`-th frame is written, as a render of the animation would draw them, and so
    many fewer pictures a second, so that the path takes as long as on the timeline. The scene
    stands at its own frame again afterwards. Depth of field, motion blur and clipping distances
    have no place in the file. Times go from 0 at the first to 1 at the last frame, as readers of
    moving scenes take them; a cameras.json has none.

    Args:
        path: The file to write.
        camera: A perspective camera; its lens, sensor and shift may be animated.
        scene: Gives range, resolution and pixel aspect.
        root: A capture's empty, whose world is written; None: Blender's world.
        kind: CAMERAS, TRANSFORMS or NERFSTUDIO.

    Returns:
        How many frames were written.

    Raises:
        GsError: the file cannot be written.
        ValueError: the camera is orthographic, panoramic or sheared at some frame, or has
            distortion, which a cameras.json cannot state, and no straightened photo, or a lens that
            nerfstudio's file cannot.
    """
    here, views = (scene.frame_current, scene.frame_subframe), []
    try:
        for number in range(scene.frame_start, scene.frame_end + 1, scene.frame_step):
            scene.frame_set(number)
            depsgraph = bpy.context.evaluated_depsgraph_get()
            (view,) = collect([camera], scene, root, depsgraph, photos=False)
            views.append(replace(view, name=f"frame_{number:06d}.png", photo=None))
    finally:
        scene.frame_set(here[0], subframe=here[1])
    pace = scene.render.fps / scene.render.fps_base / scene.frame_step
    if kind == TRANSFORMS:
        times = np.linspace(0, 1, len(views)).tolist()
        text = transforms_text(views, Path(path).parent, {"fps": pace}, times=times)
        atomic_write(path, text.encode())
    elif kind == NERFSTUDIO:
        write_nerfstudio_path(path, _pinholes(views), fps=pace)
    else:
        write_cameras(path, _pinholes(views))
    return len(views)


def _pinholes(views: list[ExportView]) -> Cameras:
    Ks = np.tile(np.eye(3), (len(views), 1, 1))
    for K, view in zip(Ks, views, strict=True):
        if view.camera.model != "PINHOLE":
            raise ValueError(
                f"{view.name} has the camera model {view.camera.model}, but cameras.json and "
                f"camera_path.json know PINHOLE alone. Export a transforms.json."
            )
        K[[0, 1, 0, 1], [0, 1, 2, 2]] = view.camera.params
    return Cameras(
        viewmats=np.stack([view.viewmat for view in views]).astype(np.float64),
        Ks=Ks,
        widths=np.array([view.camera.width for view in views], np.int64),
        heights=np.array([view.camera.height for view in views], np.int64),
        names=tuple(view.name for view in views),
    )
