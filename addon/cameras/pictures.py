"""Pictures of a capture, decoded by Blender."""

from pathlib import Path
from typing import NamedTuple

import bpy
import numpy as np

from ..srgb import encode
from .objects import PhotoCamera


class Decoded(NamedTuple):
    """A picture file as Blender gives it."""

    path: str
    values: np.ndarray
    """[H, W, 1, 3 or 4] float32, the bottom row first."""
    is_linear: bool
    """Whether it is linear light: 16 bits and more are decoded to it, bytes left as they are."""

    def arranged(self, own: PhotoCamera) -> np.ndarray:
        """As [H, W, 4] float32, straight alpha, sRGB values, the top row first; touches no bpy.

        Raises:
            ValueError: it has another shape than its camera.
        """
        height, width, channels = self.values.shape
        across, down = own.taken
        # Copies of a photo at other sizes (images_2) are rounded to whole pixels.
        if abs(width * down - height * across) > across + down:
            raise ValueError(
                f"{self.path} is {width} x {height} pixels, its camera was made for {across} x "
                f"{down}: find the photo that COLMAP saw."
            )
        pixels = np.ones((height, width, 4), np.float32)
        pixels[..., : 3 if channels == 1 else channels] = self.values[::-1]
        if self.is_linear:
            pixels[..., :3] = encode(pixels[..., :3])
        return pixels


def read_picture(path: str, own: PhotoCamera) -> np.ndarray:
    """A picture file as `Decoded.arranged`.

    Raises:
        ValueError: it is not there, cannot be decoded, or has another shape than its camera.
    """
    return decode(path).arranged(own)


def decode(path: str) -> Decoded:
    """A picture file.

    Raises:
        ValueError: it is not there, or cannot be decoded.
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
        return _decoded(image, path)
    finally:
        bpy.data.images.remove(image)


def levels_of(values: np.ndarray) -> np.ndarray:
    """uint8 of values in [0, 1], of any shape."""
    levels = np.multiply(values, np.float32(255))
    np.clip(levels, 0, 255, out=levels)
    levels += np.float32(0.5)
    return levels.astype(np.uint8)


def _decoded(image: bpy.types.Image, path: str) -> Decoded:
    width, height = image.size
    if not width * height or image.channels not in (1, 3, 4):
        raise ValueError(f"{path} is no picture that Blender can decode.")
    flat = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(flat)
    return Decoded(path, flat.reshape(height, width, image.channels), image.is_float)
