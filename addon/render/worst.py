"""The photo that splats meet worst, as their run was measured, and the camera that took it."""

import json
from dataclasses import dataclass
from pathlib import Path

import bpy

from .. import stored_paths
from ..cameras.objects import cameras_of, is_camera, root_of
from ..core import judged_psnr
from ..paths import MEASURED


@dataclass(frozen=True, kw_only=True)
class Worst:
    """What `worst_of` found."""

    camera: bpy.types.Object
    psnr: float
    """dB, as it was measured."""
    among: int
    """How many photos were measured whose cameras are there."""


def worst_of(scene: bpy.types.Scene, ob: bpy.types.Object) -> Worst:
    """The camera of the worst measured photo of the run that splats come from.

    Args:
        scene: Has the cameras, where the splats are under no capture.
        ob: The splats.

    Raises:
        ValueError: the splats come from no run, its evaluation cannot be read, or none of its
            photos has a camera here.
    """
    folder = stored_paths.read(ob, stored_paths.RUN)
    if not folder:
        raise ValueError(f"{ob.name} comes from no training here, which would know its photos.")
    path = _figures(Path(folder))
    found = _evaluated(path)
    root = root_of(ob)
    cameras = cameras_of(root) if root is not None else filter(is_camera, scene.objects)
    known = [
        (found[name], camera) for camera in cameras if (name := camera.get("gs_image")) in found
    ]
    if not known:
        raise ValueError(
            f"None of the photos that {path} tells of has a camera here: import the cameras of "
            "that capture."
        )
    psnr, camera = min(known, key=lambda pair: pair[0])
    return Worst(camera=camera, psnr=psnr, among=len(known))


def _figures(run: Path) -> Path:
    """The metrics.json of all photos, where Measure Errors wrote one since the training; else that
    of the training, which knows some."""
    measured = run / MEASURED / "metrics.json"
    try:
        if measured.stat().st_mtime >= (run / "point_cloud.ply").stat().st_mtime:
            return measured
    except OSError:
        pass
    return run / "metrics.json"


def _evaluated(path: Path) -> dict[str, float]:
    """PSNR in dB of the photos that an evaluation tells of, by name."""
    try:
        content = json.loads(path.read_bytes())
        views = {str(view["name"]): judged_psnr(view) for view in content["views"]}
        return {name: float(psnr) for name, psnr in views.items() if psnr is not None}
    except (OSError, ValueError, RecursionError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(
            f"{path} tells of no photos ({error!r}): train to the end to have them evaluated."
        ) from error
