"""Background photos: images behind or in front of a view's camera; for draw handlers."""

from collections.abc import Iterator
from dataclasses import dataclass

import bpy
import gpu
import numpy as np

from ..render.regions import camera_of, frame_of


@dataclass(frozen=True, kw_only=True)
class FrontPhoto:
    """A picture that Blender has drawn over a view before the splats are drawn."""

    texture: gpu.types.GPUTexture
    frame: tuple[float, float, float, float]
    """Left, bottom, width and height of the picture, pixels of the view."""
    opacity: float


def is_behind(context: bpy.types.Context) -> bool:
    """Whether a view's camera has a background picture with depth Back."""
    return any(slot.display_depth == "BACK" for slot in _shown(context))


def are_behind(context: bpy.types.Context) -> bool:
    """Whether a view's camera has background pictures with depth Back, and none with Front."""
    return {slot.display_depth for slot in _shown(context)} == {"BACK"}


def in_front(
    context: bpy.types.Context, window: np.ndarray, width: int, height: int
) -> FrontPhoto | None:
    """The picture with depth Front of a view's camera, if it is a still that fills the frame as the
    photos of captures do. Blender does not report the shown frame of movies and sequences.

    Args:
        context: Context of the view.
        window: [4, 4] float64, Blender's projection.
        width: Width of the view, px.
        height: Height of the view, px.
    """
    found = [s for s in _shown(context) if s.display_depth == "FRONT" and _fills_frame(s)]
    if not found:
        return None
    slot, camera = found[-1], camera_of(context)
    texture = gpu.texture.from_image(slot.image)  # already made by Blender
    low, size = frame_of(camera, context.scene, window, width, height)
    return FrontPhoto(texture=texture, frame=(*low, *size), opacity=slot.alpha)


def _shown(context: bpy.types.Context) -> Iterator[bpy.types.CameraBackgroundImage]:
    """Background pictures that are drawn for a view's camera."""
    camera = camera_of(context)
    if camera is None or camera.type != "CAMERA" or not context.space_data.overlay.show_overlays:
        return
    if not camera.data.show_background_images:
        return
    for slot in camera.data.background_images:
        picture = slot.image if slot.source == "IMAGE" else slot.clip
        if picture is None or not slot.show_background_image or not slot.alpha:
            continue
        if all(picture.size):  # else the file is missing
            yield slot


def _fills_frame(slot: bpy.types.CameraBackgroundImage) -> bool:
    moved = any(slot.offset) or slot.rotation or slot.scale != 1
    turned = slot.use_flip_x or slot.use_flip_y
    still = slot.source == "IMAGE" and slot.image.source not in {"MOVIE", "SEQUENCE"}
    return still and slot.frame_method == "STRETCH" and not (moved or turned)
