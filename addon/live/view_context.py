"""View context: shading of a 3D view, and background photos and objects other than
splats in it; for draw handlers.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import bpy
import gpu
import numpy as np

from ..compat import rec709_to_scene
from ..render.engine import NAME
from ..render.operators import changes_colors
from ..render.regions import camera_of, frame_of
from ..splats.objects import is_splats
from .clip import Cuts


@dataclass(frozen=True, kw_only=True)
class FrontPhoto:
    """A picture that Blender has drawn over a view before the splats are drawn."""

    texture: gpu.types.GPUTexture
    frame: tuple[float, float, float, float]
    """Left, bottom, width and height of the picture, pixels of the view."""
    opacity: float


def photo_depths(context: bpy.types.Context) -> set[str]:
    """Depths, BACK or FRONT, of the background pictures of a view's camera."""
    return {slot.display_depth for slot in _shown(context)}


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


_HIDES = {"MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME"}
"""Object types that may hide splats."""


def is_own(context: bpy.types.Context) -> bool:
    """Whether the view is in Rendered shading of the add-on's engine."""
    return context.space_data.shading.type == "RENDERED" and context.scene.render.engine == NAME


def keeps_colors(context: bpy.types.Context) -> bool:
    """Whether a view shows decoded sRGB values in its picture unchanged."""
    scene = context.scene
    plain = context.space_data.shading.type == "SOLID" or not changes_colors(scene)
    device = scene.display_settings.display_device
    return plain and device == "sRGB" and np.allclose(rec709_to_scene(), np.eye(3), atol=1e-6)


def is_hidden_by_others(context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether any object may hide splats; reading depths means waiting for the card."""
    if is_own(context):
        return False  # it draws no meshes, though Blender adds their depths for its lines
    if context.space_data.overlay.show_overlays:
        return True  # lines: wires, bones, boxes of splats, the grid
    return any(ob.type in _HIDES and _has_surface(ob) for ob in depsgraph.objects)


def has_lines_in_front(context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether lines may be drawn over everything (In Front)."""
    if is_own(context) or not context.space_data.overlay.show_overlays:
        return False
    return any(ob.show_in_front for ob in depsgraph.objects)


def _has_surface(ob: bpy.types.Object) -> bool:
    if is_splats(ob):
        return ob.original.gscore.display in {"POINTS", "ELLIPSOIDS", "SOFT", "NATIVE"}
    return ob.display_type in {"SOLID", "TEXTURED"}


def cuts_of(context: bpy.types.Context) -> Cuts:
    """The clipping of a view, as for meshes; the engine's shading has no far end."""
    space, region = context.space_data, context.region_data
    if not region.use_clip_planes or space.shading.type != "SOLID":
        return Cuts(far=not is_own(context))
    planes = np.array(region.clip_planes, np.float64)[: 4 if region.use_box_clip else 6]
    return Cuts(far=True, planes=planes)
