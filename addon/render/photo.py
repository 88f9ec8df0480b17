"""The photo of an imported camera, with its mask, as training sees it."""

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from .. import stored_paths
from ..cameras.objects import cameras_of, root_of, stated
from ..cameras.pictures import levels_of, read_picture
from ..cameras.straight import undistortion_of
from ..core import Folder, Undistortion, are_mattes, downscale

MASKS = "masks"
"""Folder of masks in a capture, where the capture names no others."""


@dataclass(frozen=True, kw_only=True)
class Target:
    """What a picture is compared with."""

    pixels: np.ndarray
    """[H, W, 3] float32 sRGB values, the top row first."""
    weight: np.ndarray | None
    """[H, W] float32 in [0, 1], how much a pixel counts; None: all alike."""


def load_target(
    camera: bpy.types.Object,
    width: int,
    height: int,
    *,
    background: tuple[float, float, float],
    mask_mode: str,
    invert_masks: bool = False,
) -> Target:
    """A camera's photo and mask at another size, scaled as for training.

    Args:
        camera: Of an imported capture.
        width: Pixels, at most the photo's.
        height: Pixels, at most the photo's.
        background: sRGB values that photos are composited over where their opacity says so.
        mask_mode: As gscore's option: `auto`, `composite`, `ignore` or `none`. Masks are files of
            the photos' names in the capture's folder `masks`, else the photos' opacity.
        invert_masks: Mask files are white where pixels do not count.

    Raises:
        ValueError: photo or mask cannot be decoded or have other shapes than the camera.
    """
    own = stated(camera)
    plan = undistortion_of(own)
    rgba = read_picture(own.photo, own)
    place = None if mask_mode == "none" else mask_folder(camera)
    file = None if place is None else Folder(place).find_mask(own.image)
    opacity, mode = rgba[..., 3], mask_mode
    if file is not None:
        mask = read_picture(str(file), own)
        if mask.shape != rgba.shape:
            raise ValueError(
                f"The mask {file} is {mask.shape[1]} x {mask.shape[0]} pixels, its photo "
                f"{rgba.shape[1]} x {rgba.shape[0]}: make them the same."
            )
        opacity = kept_of(mask, invert_masks)
        if mask_mode == "auto":
            mode = "composite" if _cut_out(camera, invert_masks) else "ignore"
    elif mask_mode == "auto":
        mode = "composite"
    if plan is not None:
        cuts_out = file is None and mask_mode != "none"
        rgba, opacity = _straightened(rgba[..., :3], opacity, plan, cut_out=cuts_out)
    if width > rgba.shape[1] or height > rgba.shape[0]:
        raise ValueError(
            f"The photo {own.photo} has {rgba.shape[1]} x {rgba.shape[0]} pixels, {width} x "
            f"{height} are asked for: lower the scene's resolution percentage."
        )
    pixels = _scaled(rgba[..., :3], width, height)
    weight = _scaled(opacity, width, height)
    if mode == "composite" and opacity.min() < 1:
        # Averaged with the colours multiplied, so that hidden ones do not bleed in.
        colors = _scaled(rgba[..., :3] * opacity[..., None], width, height)
        pixels = colors + np.array(background, np.float32) * (1 - weight[..., None])
    ignores = mode == "ignore" and opacity.min() < 1
    return Target(pixels=pixels, weight=weight if ignores else None)


def _straightened(
    colors: np.ndarray, opacity: np.ndarray, plan: Undistortion, *, cut_out: bool
) -> tuple[np.ndarray, np.ndarray]:
    """A photo [h, w, 3] and what says where it counts [h, w] as a training straightens them.

    Args:
        colors: In [0, 1].
        opacity: In [0, 1].
        plan: The way to what the camera sees.
        cut_out: The opacity is the photo's own, and not a mask.
    """
    photo, mask = levels_of(colors), levels_of(opacity)
    if cut_out:
        rgba = plan.straighten(np.dstack([photo, mask])) / np.float32(255)
        return rgba, rgba[..., 3]
    straight = plan.straighten(photo)
    height, width = straight.shape[:2]
    scale = (mask.shape[1] / plan.camera.width, mask.shape[0] / plan.camera.height)
    # A mask of only yes and no stays one: half-transparent rims would be invented otherwise.
    yes_or_no = not ((mask > 0) & (mask < 255)).any()
    kept = plan.remap(mask, (width, height), pixels=scale, nearest=yes_or_no)
    return straight / np.float32(255), kept / np.float32(255)


def kept_of(mask: np.ndarray, inverted: bool) -> np.ndarray:
    """[H, W] of a mask [H, W, 4], 1 = keep."""
    opacity = mask[..., 3] if mask[..., 3].min() < 1 else mask[..., :3].max(axis=2)
    opacity = _yes_or_no(opacity)
    return 1 - opacity if inverted else opacity


def _cut_out(camera: bpy.types.Object, inverted: bool) -> bool:
    """Whether the masks of a camera's capture cut a subject out, as training sees that."""
    root = root_of(camera)
    place = mask_folder(camera)
    if root is None or place is None:
        return False
    folder = Folder(place)
    own = [stated(other) for other in cameras_of(root)]
    masks = [(file, one) for one in own if (file := folder.find_mask(one.image)) is not None]

    def levels(i: int) -> np.ndarray:
        file, one = masks[i]
        return levels_of(kept_of(read_picture(str(file), one), inverted))

    return are_mattes(len(masks), levels)


def _yes_or_no(opacity: np.ndarray) -> np.ndarray:
    """A mask of 0 and one other number as one of 0 and 1, as gscore reads masks."""
    top = opacity.max()
    if not ((opacity == 0) | (opacity == top)).all() or (opacity.min() > 1 / 255):
        return opacity
    return (opacity > 0).astype(np.float32)


def mask_folder(camera: bpy.types.Object) -> Path | None:
    """The folder of masks of a camera's capture, if it is there."""
    place = mask_place(camera)
    return place if place is not None and place.is_dir() else None


def mask_place(camera: bpy.types.Object) -> Path | None:
    """Where masks of a camera's capture belong; None: the camera is of none."""
    root = root_of(camera)
    if root is None:
        return None
    source = Path(stored_paths.read(root, stored_paths.SOURCE))
    return (source.parent if source.is_file() else source) / MASKS


def _scaled(values: np.ndarray, width: int, height: int) -> np.ndarray:
    """[height, width, ...] float32 of values in [0, 1], by way of bytes as in training."""
    return downscale(levels_of(values), width, height) / np.float32(255)
