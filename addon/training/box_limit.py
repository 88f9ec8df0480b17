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
    """Sentence about conflicting settings of a scene; empty without a conflict."""
    ob = settings.train_within
    if ob is None:
        return ""
    if settings.use_masks and settings.mask_mode == "composite":
        return (
            f"Masks used as opacity already cut out the subject, so {ob.name} cannot limit it: set "
            "Mask Mode to Ignore Masked, or clear Limit to Object."
        )
    if not settings.sky:
        return ""
    return (
        f"Only the inside of {ob.name} is trained, so there is no sky: turn Sky off, or "
        "clear Limit to Object."
    )


def arguments(scene: bpy.types.Scene, output: Path) -> list[str]:
    """Write the box of a scene's object into `output`; return the trainer's option for it.

    The file name has a hash of the content, so that the file of an earlier run stays unchanged.

    Raises:
        ValueError: the capture is not in the scene, the object has no volume, or settings conflict.
        GsError: the file cannot be written.
    """
    ob = scene.gscore.train_within
    if ob is None:
        return []
    if conflict := problem(scene.gscore):
        raise ValueError(conflict)
    root = panel_root(scene)
    if root is None:
        raise ValueError(
            f"{ob.name} limits the training by its position among the photos: press Import "
            "Cameras first, or clear Limit to Object."
        )
    to_unit = crop_matrix(root, ob)
    if not abs(np.linalg.det(to_unit[:3, :3])) > 0:
        raise ValueError(f"{ob.name} has no volume; scale it up on all axes.")
    box = box_of_capture(np.linalg.inv(to_unit), root)
    path = output / GUIDES / f"within-{hashlib.sha256(box.tobytes()).hexdigest()[:8]}.json"
    if not path.is_file():
        write_region(path, box)
    return ["--region", str(path)]
