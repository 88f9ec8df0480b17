"""Pictures of a capture, decoded by Blender."""

from pathlib import Path

import bpy
import numpy as np

from ..srgb import encode
from .objects import PhotoCamera


def read_picture(path: str, own: PhotoCamera) -> np.ndarray:
    """A picture file as [H, W, 4] float32, straight alpha, sRGB values, the top row first.

    Raises:
        ValueError: it is not there, cannot be decoded, or has another shape than its camera.
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
    across, down = own.taken
    # Copies of a photo at other sizes (images_2) are rounded to whole pixels.
    if abs(width * down - height * across) > across + down:
        raise ValueError(
            f"{path} is {width} x {height} pixels, its camera was made for {across} x {down}: find "
            f"the photo that COLMAP saw."
        )
    return pixels


def levels_of(values: np.ndarray) -> np.ndarray:
    """uint8 of values in [0, 1], of any shape."""
    levels = np.multiply(values, np.float32(255))
    np.clip(levels, 0, 255, out=levels)
    levels += np.float32(0.5)
    return levels.astype(np.uint8)


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
        pixels[..., :3] = encode(pixels[..., :3])
    return pixels
