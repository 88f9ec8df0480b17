"""Background photos: images behind or in front of a view's camera; for draw handlers."""

from collections.abc import Iterator
from dataclasses import dataclass

import bpy
import gpu
import numpy as np

from ..render.regions import camera_of, frame_of


@dataclass(frozen=True, kw_only=True)
class FrontPhoto:
    """A picture that Blender has drawn over a view already, before splats come."""

    texture: gpu.types.GPUTexture
    frame: tuple[float, float, float, float]
    """Left, bottom, width and height of where it is, pixels of the view."""
    opacity: float


def is_behind(context: bpy.types.Context) -> bool:
    """Whether a picture is seen behind what stands before a view's camera."""
    return any(slot.display_depth == "BACK" for slot in _shown(context))


def are_behind(context: bpy.types.Context) -> bool:
    """Whether pictures are, and none before it."""
    return {slot.display_depth for slot in _shown(context)} == {"BACK"}


def in_front(
    context: bpy.types.Context, window: np.ndarray, width: int, height: int
) -> FrontPhoto | None:
    """The picture before a view's camera, if it fills the frame as the photos of captures do, and
    is one: of films and sequences Blender does not tell which frame it shows.

    Args:
        context: Of the view.
        window: [4, 4] float64, Blender's projection.
        width: Of the view, pixels.
        height: Of the view, pixels.
    """
    found = [s for s in _shown(context) if s.display_depth == "FRONT" and _fills_frame(s)]
    if not found:
        return None
    slot, camera = found[-1], camera_of(context)
    texture = gpu.texture.from_image(slot.image)  # which Blender has made already
    low, size = frame_of(camera, context.scene, window, width, height)
    return FrontPhoto(texture=texture, frame=(*low, *size), opacity=slot.alpha)


def _shown(context: bpy.types.Context) -> Iterator[bpy.types.CameraBackgroundImage]:
    """What is drawn of a view's camera."""
    camera = camera_of(context)
    if camera is None or camera.type != "CAMERA" or not context.space_data.overlay.show_overlays:
        return
    if not camera.data.show_background_images:
        return
    for slot in camera.data.background_images:
        picture = slot.image if slot.source == "IMAGE" else slot.clip
        if picture is None or not slot.show_background_image or not slot.alpha:
            continue
        if all(picture.size):  # else the file is not there
            yield slot


def _fills_frame(slot: bpy.types.CameraBackgroundImage) -> bool:
    moved = any(slot.offset) or slot.rotation or slot.scale != 1
    turned = slot.use_flip_x or slot.use_flip_y
    still = slot.source == "IMAGE" and slot.image.source not in {"MOVIE", "SEQUENCE"}
    return still and slot.frame_method == "STRETCH" and not (moved or turned)
