"""Box limit: the bounding box of an object, to which a training is limited."""

import hashlib
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..cameras.capture_transform import box_of_capture
from ..cameras.lookup import panel_root
from ..core import GUIDES, write_region
from ..splats.filters import crop_matrix


def problem(settings: Any) -> str:
    """A sentence on settings of a scene that exclude each other; else empty."""
    ob = settings.train_within
    if ob is None:
        return ""
    if settings.use_masks and settings.mask_mode == "composite":
        return (
            f"Masks that are opacity cut the subject out, which {ob.name} cannot narrow: choose "
            "Masks Mean: Leave Out, or clear Only Within."
        )
    if not settings.sky:
        return ""
    return (
        f"Nothing but what lies in {ob.name} is trained, so there is no sky: turn Sky off, or "
        "clear Only Within."
    )


def arguments(scene: bpy.types.Scene, output: Path) -> list[str]:
    """Write the box of a scene's object into `output`; return the trainer's option for it.

    The file is named by what it holds, so that one of an earlier run stays as it is.

    Raises:
        ValueError: the capture is not in the scene, the object has no volume, or the settings ask
            for what cannot be had together.
        GsError: the file cannot be written.
    """
    ob = scene.gscore.train_within
    if ob is None:
        return []
    if not_together := problem(scene.gscore):
        raise ValueError(not_together)
    root = panel_root(scene)
    if root is None:
        raise ValueError(
            f"{ob.name} limits the training by where it stands among the photos: press Import "
            "Cameras first, or clear Only Within."
        )
    to_unit = crop_matrix(root, ob)
    if not abs(np.linalg.det(to_unit[:3, :3])) > 0:
        raise ValueError(f"{ob.name} has no volume; scale it up on all axes.")
    box = box_of_capture(np.linalg.inv(to_unit), root)
    path = output / GUIDES / f"within-{hashlib.sha256(box.tobytes()).hexdigest()[:8]}.json"
    if not path.is_file():
        write_region(path, box)
    return ["--region", str(path)]
