"""Camera photo: the photo of an imported camera, with its mask, as the training loads it."""

from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple

import bpy
import numpy as np

from .. import stored_paths
from ..cameras.objects import PhotoCamera, cameras_of, is_camera, photo_camera_of, root_of
from ..cameras.pictures import Decoded, decode, levels_of
from ..cameras.undistorted_photos import undistortion_of
from ..core import (
    DataConfig,
    Folder,
    Undistortion,
    are_mattes,
    downscale,
    masks_inside,
    read_capture,
)
from ..interface.blocks import with_uid
from ..process.incremental_tasks import Check, Steps, run_in_thread

MASKS = "masks"
"""Folder of masks in a capture, where the capture names no others."""


_READING = "Reading the photo"


@dataclass(frozen=True, kw_only=True)
class Target:
    """The photo that a picture is compared with."""

    pixels: np.ndarray
    """[H, W, 3] float32 sRGB values, the top row first."""
    weight: np.ndarray | None
    """[H, W] float32 in [0, 1], weight of each pixel; None: all equal."""


def load_target(
    camera: bpy.types.Object,
    width: int,
    height: int,
    *,
    background: tuple[float, float, float],
    mask_mode: str,
    invert_masks: bool = False,
) -> Steps[Target]:
    """A camera's photo and mask at another size, scaled as for training.

    Args:
        camera: Of an imported capture.
        width: Pixels, at most the photo's.
        height: Pixels, at most the photo's.
        background: sRGB values behind transparent pixels of photos.
        mask_mode: As gscore's option: `auto`, `composite`, `ignore` or `none`. Masks are the
            files that the capture names, else those of its folder `masks` or `mask` with the
            photos' names, else the photos' opacity.
        invert_masks: Mask files are white where pixels do not count.

    Raises:
        ValueError: photo or mask cannot be decoded, or their shape differs from the camera's.
    """
    own = photo_camera_of(camera)
    source = None if mask_mode == "none" else source_of(camera)
    file, masks = None, []
    if source is not None:
        root = root_of(camera) if mask_mode == "auto" else None
        cameras = [] if root is None else cameras_of(root)
        listed = [_Masked(ob.session_uid, str(ob.get("gs_image", ""))) for ob in cameras]
        file, masks = yield from run_in_thread(
            partial(_find_masks, source, own.image, listed), _READING
        )
    photo = decode(own.photo)
    yield _READING
    mask = None
    if file is not None:
        mask = decode(file)
        yield _READING
    if masks:
        cut_out = yield from _cut_out(masks, invert_masks)
        mask_mode = "composite" if cut_out else "ignore"
    settings = (own, (width, height), background, mask_mode, invert_masks)
    return (yield from run_in_thread(partial(_target, photo, mask, *settings), _READING))


def _target(
    photo: Decoded,
    mask: Decoded | None,
    own: PhotoCamera,
    size: tuple[int, int],
    background: tuple[float, float, float],
    mode: str,
    inverted: bool,
    check: Check,
) -> Target:
    """Like `load_target`, without bpy."""
    width, height = size
    plan = undistortion_of(own)
    rgba = photo.arranged(own)
    opacity = rgba[..., 3]
    if mask is not None:
        values = mask.arranged(own)
        if values.shape[0] < rgba.shape[0] or values.shape[1] < rgba.shape[1]:
            raise ValueError(
                f"The mask {mask.path} is {values.shape[1]} x {values.shape[0]} pixels, its photo "
                f"{rgba.shape[1]} x {rgba.shape[0]}: make them the same."
            )
        opacity = kept_of(values, inverted)
        if values.shape != rgba.shape:
            opacity = _scaled(opacity, rgba.shape[1], rgba.shape[0])
    elif mode == "auto":
        mode = "composite"
    if plan is not None:
        cuts_out = mask is None and mode != "none"
        rgba, opacity = _undistorted(rgba[..., :3], opacity, plan, cut_out=cuts_out)
    if width > rgba.shape[1] or height > rgba.shape[0]:
        raise ValueError(
            f"The photo {own.photo} has {rgba.shape[1]} x {rgba.shape[0]} pixels, fewer than "
            f"{width} x {height}: lower the scene's resolution percentage."
        )
    pixels = _scaled(rgba[..., :3], width, height)
    weight = _scaled(opacity, width, height)
    if mode == "composite" and opacity.min() < 1:
        # Averages premultiplied colours, so that hidden ones do not bleed in.
        colors = _scaled(rgba[..., :3] * opacity[..., None], width, height)
        pixels = colors + np.array(background, np.float32) * (1 - weight[..., None])
    ignores = mode == "ignore" and opacity.min() < 1
    return Target(pixels=pixels, weight=weight if ignores else None)


def _undistorted(
    colors: np.ndarray, opacity: np.ndarray, plan: Undistortion, *, cut_out: bool
) -> tuple[np.ndarray, np.ndarray]:
    """A photo [h, w, 3] and its weights [h, w], undistorted as for a training.

    Args:
        colors: In [0, 1].
        opacity: In [0, 1].
        plan: From the photo to the pinhole camera.
        cut_out: The opacity is the photo's own, not a mask.
    """
    photo, mask = levels_of(colors), levels_of(opacity)
    if cut_out:
        rgba = plan.undistort_photo(np.dstack([photo, mask])) / np.float32(255)
        return rgba, rgba[..., 3]
    straight = plan.undistort_photo(photo)
    height, width = straight.shape[:2]
    scale = (mask.shape[1] / plan.camera.width, mask.shape[0] / plan.camera.height)
    # Interpolation would give a binary mask half-transparent rims.
    yes_or_no = not ((mask > 0) & (mask < 255)).any()
    kept = plan.remap(mask, (width, height), pixels=scale, nearest=yes_or_no)
    return straight / np.float32(255), kept / np.float32(255)


def kept_of(mask: np.ndarray, inverted: bool) -> np.ndarray:
    """Weights [H, W] of a mask [H, W, 4], 1 = keep."""
    opacity = mask[..., 3] if mask[..., 3].min() < 1 else mask[..., :3].max(axis=2)
    top = opacity.max()
    if ((opacity == 0) | (opacity == top)).all() and opacity.min() <= 1 / 255:
        opacity = (opacity > 0).astype(np.float32)  # as gscore reads masks of 0 and one other value
    return 1 - opacity if inverted else opacity


class _Masked(NamedTuple):
    """A camera of a capture by its uid, because undo replaces objects."""

    uid: int
    """Session number of the object."""
    image: str
    file: str = ""
    """File of the mask."""


def _find_masks(
    source: Path, image: str, listed: list[_Masked], check: Check
) -> tuple[str | None, list[_Masked]]:
    """The mask of an image of a capture, and, where there is one, the cameras that have one too."""
    place = masks_inside(folder_of(source))
    folder, stated_files = None if place is None else Folder(place), stated_masks(source)

    def find(name: str) -> str:
        if stated_files:  # as in training, the folder is ignored if the capture names masks
            file = stated_files.get(name)
            return str(file) if file is not None and file.is_file() else ""
        return "" if folder is None else str(folder.find_mask(name) or "")

    file = find(image)
    if not file:
        return None, []
    found = [one._replace(file=find(one.image)) for one in listed]
    return file, [one for one in found if one.file]


def _cut_out(masks: list[_Masked], inverted: bool) -> Steps[bool]:
    """Whether masks cut a subject out, by the rule of training."""
    sampled: list[int] = []
    blank = np.zeros((8, 8), np.uint8)
    are_mattes(len(masks), lambda i: (sampled.append(i), blank)[1])  # which ones it reads
    levels = {}
    for done, i in enumerate(sampled):
        one = masks[i]
        ob = with_uid(bpy.data.objects, one.uid)
        if not is_camera(ob):
            raise ValueError(
                f"The camera of {one.image} was removed while masks were read: compare again."
            )
        mask, own = decode(one.file), photo_camera_of(ob)
        levels[i] = yield from run_in_thread(
            lambda check, mask=mask, own=own: levels_of(kept_of(mask.arranged(own), inverted)),
            f"Reading masks: {done / len(sampled):.0%}",
        )
    return are_mattes(len(masks), levels.__getitem__)


def mask_folder(camera: bpy.types.Object) -> Path | None:
    """The folder of masks of a camera's capture, if it exists."""
    source = source_of(camera)
    return None if source is None else masks_inside(folder_of(source))


def mask_place(camera: bpy.types.Object) -> Path | None:
    """The folder for masks of a camera's capture; None: the camera belongs to none."""
    source = source_of(camera)
    return None if source is None else mask_folder(camera) or folder_of(source) / MASKS


def source_of(camera: bpy.types.Object) -> Path | None:
    """The file or folder of a camera's capture; None: the camera belongs to none."""
    root = root_of(camera)
    return None if root is None else Path(stored_paths.read(root, stored_paths.SOURCE))


def folder_of(source: Path) -> Path:
    """The folder of a capture; `source` is the folder or a file in it."""
    return source.parent if source.is_file() else source


def stated_masks(source: Path) -> dict[str, Path]:
    """Mask files by photo name, as a capture lists them; empty if the capture is gone."""
    if not source.exists():
        return {}
    listed = source.glob("*.json") if source.is_dir() else ()
    stamps = (file.stat().st_mtime_ns for file in (source, *sorted(listed)) if file.exists())
    return _stated_masks(source, tuple(stamps))


@lru_cache(maxsize=4)
def _stated_masks(source: Path, stamps: tuple[int, ...]) -> dict[str, Path]:
    """`stated_masks`, cached, because reading a capture takes 0.2 ms a photo.

    Args:
        source: The capture.
        stamps: Modification times of its folder and its JSON files, ns.
    """
    views = read_capture(DataConfig(source=source)).views
    return {view.name: view.mask for view in views if view.mask is not None}


def _scaled(values: np.ndarray, width: int, height: int) -> np.ndarray:
    """Values in [0, 1] at another size, [height, width, ...] float32, via bytes as in training."""
    return downscale(levels_of(values), width, height) / np.float32(255)
