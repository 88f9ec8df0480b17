"""Pictures of a capture, decoded by Blender."""

from pathlib import Path
from typing import NamedTuple

import bpy
import numpy as np

from ..srgb import encode
from .objects import PhotoCamera


class Decoded(NamedTuple):
    """A picture file decoded by Blender."""

    path: str
    values: np.ndarray
    """[H, W, 1, 3 or 4] float32, the bottom row first."""
    is_linear: bool
    """True for linear light: Blender decodes 16 bits and more to it, and keeps bytes."""

    def arranged(self, own: PhotoCamera) -> np.ndarray:
        """Return [H, W, 4] float32, straight alpha, sRGB, the top row first; uses no bpy.

        Raises:
            ValueError: its aspect ratio differs from its camera's.
        """
        height, width, channels = self.values.shape
        across, down = own.taken
        # Copies of a photo at other sizes (images_2) are rounded to whole pixels.
        if abs(width * down - height * across) > across + down:
            raise ValueError(
                f"{self.path} has {width} x {height} pixels, but its camera {across} x {down}: use "
                f"the photo that COLMAP has read."
            )
        pixels = np.ones((height, width, 4), np.float32)
        pixels[..., : 3 if channels == 1 else channels] = self.values[::-1]
        if self.is_linear:
            pixels[..., :3] = encode(pixels[..., :3])
        return pixels


def read_picture(path: str, own: PhotoCamera) -> np.ndarray:
    """A picture file as `Decoded.arranged`.

    Raises:
        ValueError: it is missing, cannot be decoded, or differs from its camera in aspect ratio.
    """
    return decode(path).arranged(own)


def decode(path: str) -> Decoded:
    """Decode a picture file.

    Raises:
        ValueError: it is missing, or cannot be decoded.
    """
    if Path(path).suffix.lower() in bpy.path.extensions_movie:
        raise ValueError(f"{path} is a video file, which may refer to other files; use pictures.")
    try:
        image = bpy.data.images.load(path, check_existing=False)
    except RuntimeError as error:
        raise ValueError(
            f"The picture {path} cannot be read: find the capture's folder again."
        ) from error
    try:
        if not image.size[0] * image.size[1] or image.channels not in (1, 3, 4):
            raise ValueError(f"{path} is not a picture that Blender can decode.")
        return Decoded(path, pixels_of(image), image.is_float)
    finally:
        bpy.data.images.remove(image)


def levels_of(values: np.ndarray) -> np.ndarray:
    """uint8 of values in [0, 1], of any shape."""
    levels = np.multiply(values, np.float32(255))
    np.clip(levels, 0, 255, out=levels)
    levels += np.float32(0.5)
    return levels.astype(np.uint8)


def pixels_of(image: bpy.types.Image) -> np.ndarray:
    """[H, W, channels] float32 of an image, the bottom row first."""
    width, height = image.size
    flat = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(flat)
    return flat.reshape(height, width, image.channels)
