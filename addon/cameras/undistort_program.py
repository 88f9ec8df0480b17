"""Undistortion program: a second, windowless Blender that decodes, undistorts and writes photos.

It reads tasks from stdin, one JSON object per line, and answers each with one line.
"""

import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TextIO

import bpy
import numpy as np

from ..core import Undistortion
from .objects import PhotoCamera
from .pictures import levels_of, read_picture
from .undistort_queue import ANSWER, READY
from .undistorted_photos import earlier_copies, part_of, remove, undistortion_of

_QUALITY = 95
"""Quality of JPEGs, per cent."""


def task_of(own: PhotoCamera, copy: Path) -> dict[str, Any]:
    """A photo, its camera and the file of its copy, as JSON values."""
    arrays = {"K": own.K.tolist(), "viewmat": own.viewmat.tolist()}
    return {"copy": str(copy), "camera": {**vars(own), **arrays}}


def main(lines: Iterable[str] = sys.stdin, out: TextIO = sys.stdout) -> None:
    """Undistort one photo after the other until the input ends."""
    print(READY, file=out, flush=True)
    for line in lines:
        task = json.loads(line)
        problem = ""
        try:
            own = task["camera"]
            arrays = {name: np.array(own[name], np.float64) for name in ("K", "viewmat")}
            lists = {name: tuple(own[name]) for name in ("params", "photo_size")}
            undistort(PhotoCamera(**{**own, **arrays, **lists}), Path(task["copy"]))
        except (OSError, ValueError, RuntimeError, MemoryError) as error:
            problem = str(error) or type(error).__name__
        answer = json.dumps({"copy": task["copy"], "problem": problem})
        print(f"{ANSWER}{answer}", file=out, flush=True)


def undistort(own: PhotoCamera, copy: Path) -> None:
    """Write the undistorted copy of a photo, completely or not at all, and remove earlier ones.

    Raises:
        ValueError: the photo cannot be decoded, or differs from its camera in aspect ratio.
        OSError, RuntimeError: the copy cannot be written.
    """
    plan = undistortion_of(own)
    assert plan is not None
    pixels = levels_of(read_picture(own.photo, own))
    copy.parent.mkdir(parents=True, exist_ok=True)
    part = part_of(copy)
    try:
        _write(part, pixels, plan, jpeg=copy.suffix == ".jpg")
        part.replace(copy)
    finally:
        part.unlink(missing_ok=True)
    remove(earlier_copies(copy))


def _write(file: Path, photo: np.ndarray, plan: Undistortion, *, jpeg: bool) -> None:
    """Undistort [H, W, 4] uint8, and encode the result with Blender."""
    pixels = plan.undistort_photo(photo[..., :3] if jpeg else photo)
    height, width = pixels.shape[:2]
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., : pixels.shape[2]] = pixels[::-1] / np.float32(255)
    image = bpy.data.images.new(file.name, width, height, alpha=not jpeg)
    try:
        image.alpha_mode = "STRAIGHT"
        image.pixels.foreach_set(rgba.ravel())
        image.file_format = "JPEG" if jpeg else "PNG"
        image.save(filepath=str(file), quality=_QUALITY if jpeg else 0)
    finally:
        bpy.data.images.remove(image)
