"""Worst photo: the photo of a run with the lowest measured PSNR, and its camera."""

from dataclasses import dataclass
from pathlib import Path

import bpy

from .. import stored_paths
from ..cameras.objects import cameras_of, is_camera, root_of
from ..capture.figures import figures


@dataclass(frozen=True, kw_only=True)
class Worst:
    """The worst photo of a run."""

    camera: bpy.types.Object
    psnr: float
    """PSNR measured after the training, dB."""
    among: int
    """Number of measured photos with a camera in the scene."""


def worst_of(scene: bpy.types.Scene, ob: bpy.types.Object) -> Worst:
    """The camera of the worst measured photo of the run that splats come from.

    Args:
        scene: Scene of the cameras, if the splats have no capture as parent.
        ob: The splats.

    Raises:
        ValueError: the splats come from no run, its evaluation cannot be read, or none of its
            photos has a camera in the scene.
    """
    folder = stored_paths.read(ob, stored_paths.RUN)
    if not folder:
        raise ValueError(f"{ob.name} was not trained with this add-on: its photos are not known.")
    run = figures(Path(folder))
    found = dict(run.ranked)
    root = root_of(ob)
    cameras = cameras_of(root) if root is not None else filter(is_camera, scene.objects)
    known = [
        (found[name], camera) for camera in cameras if (name := camera.get("gs_image")) in found
    ]
    if not known:
        raise ValueError(
            f"None of the photos in {run.path} has a camera here: import the cameras of that "
            "capture."
        )
    psnr, camera = min(known, key=lambda pair: pair[0])
    return Worst(camera=camera, psnr=psnr, among=len(known))
