"""The photo of an imported camera, with its mask, as training sees it."""

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from .. import stored_paths
from ..cameras.objects import PhotoCamera, cameras_of, root_of, stated
from ..core import Folder, are_mattes, downscale
from . import color
from .straight import STRAIGHT, straightened

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
    rgba = read_picture(own.photo, own)
    if width > rgba.shape[1] or height > rgba.shape[0]:
        raise ValueError(
            f"The photo {own.photo} has {rgba.shape[1]} x {rgba.shape[0]} pixels, {width} x "
            f"{height} are asked for: lower the scene's resolution percentage."
        )
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
    seen = None
    if own.model not in STRAIGHT:
        both, seen = straightened(np.dstack([rgba[..., :3], opacity]), own)
        rgba, opacity = both, both[..., 3]
    pixels = _scaled(rgba[..., :3], width, height)
    weight = _scaled(opacity, width, height)
    if mode == "composite" and opacity.min() < 1:
        # Averaged with the colours multiplied, so that hidden ones do not bleed in.
        colors = _scaled(rgba[..., :3] * opacity[..., None], width, height)
        pixels = colors + np.array(background, np.float32) * (1 - weight[..., None])
    ignores = mode == "ignore" and opacity.min() < 1
    counted = weight if ignores else None
    if seen is not None and not seen.all():
        shown = _scaled(seen.astype(np.float32), width, height)
        counted = shown if counted is None else counted * shown
    return Target(pixels=pixels, weight=counted)


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
        return (kept_of(read_picture(str(file), one), inverted) * 255 + 0.5).astype(np.uint8)

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
    levels = (np.clip(values, 0, 1) * 255 + 0.5).astype(np.uint8)
    return downscale(levels, width, height) / np.float32(255)


def read_picture(path: str, own: PhotoCamera) -> np.ndarray:
    """A picture file as [H, W, 4] float32, straight alpha, sRGB values, the top row first.

    Raises:
        ValueError: it is not there, cannot be decoded, or has another shape than the camera.
    """
    if Path(path).suffix.lower() in bpy.path.extensions_movie:
        raise ValueError(f"{path} is a film, of which Blender would open what it refers to.")
    try:
        image = bpy.data.images.load(path, check_existing=False)
    except RuntimeError as error:
        raise ValueError(
            f"The picture {path} cannot be read: find the capture's folder again."
        ) from error
    try:
        pixels = _decoded(image, path)
    finally:
        bpy.data.images.remove(image)
    height, width = pixels.shape[:2]
    # Copies of a photo at other sizes (images_2) are rounded to whole pixels.
    if abs(width * own.height - height * own.width) > own.width + own.height:
        raise ValueError(
            f"{path} is {width} x {height} pixels, its camera was made for {own.width} x "
            f"{own.height}: find the photo that COLMAP saw."
        )
    return pixels


def _decoded(image: bpy.types.Image, path: str) -> np.ndarray:
    width, height = image.size
    if not width * height or image.channels not in (1, 3, 4):
        raise ValueError(f"{path} is no picture that Blender can decode.")
    flat = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(flat)
    found = flat.reshape(height, width, image.channels)[::-1]
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., : 3 if image.channels == 1 else image.channels] = found
    if image.is_float:  # 16 bits and more are decoded to linear light, bytes are left as they are
        pixels[..., :3] = color.encode(pixels[..., :3])
    return pixels
