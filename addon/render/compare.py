"""A photo beside what the splats show from its camera: pictures, and the PSNR."""

import math
from dataclasses import dataclass

import bpy
import numpy as np

from ..cameras import formulas as cm
from ..cameras.captures import RenderCamera
from ..cameras.objects import PhotoCamera, is_camera, rigid_viewmat, stated
from ..compat import matrix_to_numpy
from ..core import colorize, psnr
from . import picture
from .engine import collect, final_cache
from .photo import Target, load_target
from .world import background_of, world_light

ERROR_GAIN = 4.0
"""Error pictures show this times the mean absolute difference of the channels, as gscore's do."""
PSNR, PSNR_MASKED = "gs_psnr", "gs_psnr_masked"
"""Custom properties of a camera: results of the last comparison, dB."""
KINDS = ("Photo", "Render", "Error", "Comparison")
"""Pictures that are made; Comparison has the others side by side."""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """What `compare` found."""

    psnr: float
    """dB, of the splats' picture against the photo, on sRGB values; inf if they are equal. Where a
    mask says what counts, both are black elsewhere, as in gscore's metrics."""
    psnr_masked: float | None
    """dB, of the pixels that count alone; None without a mask."""
    images: dict[str, bpy.types.Image]
    """By the names in `KINDS`."""


def compare(
    scene: bpy.types.Scene, camera: bpy.types.Object, depsgraph: bpy.types.Depsgraph
) -> Comparison:
    """Render from an imported camera and compare with its photo.

    The picture has the photo's size times the scene's resolution percentage, whatever the scene's
    resolution; the photo is scaled to that as it is for training. Masks are heeded as the scene's
    settings for training say; what they make transparent is put over the world's colour. Photos of
    lenses that bend lines are straightened as for training.

    Args:
        scene: Gives percentage, world and settings, and receives nothing.
        camera: Of an imported capture; it is where it stands now. Receives `PSNR`.
        depsgraph: What is visible in it is drawn.

    Raises:
        ValueError: no such camera, one that is not made for straightened photos, no splats, or no
            photo.
        GsError: the native library is missing.
    """
    if not is_camera(camera):
        raise ValueError(
            f"{camera.name} is no camera of a photo: choose one that Import Capture made."
        )
    own = stated(camera)
    background = background_of(world_light(scene.world)[0])
    size = cm.frame_size(own.width, own.height, scene.render.resolution_percentage)
    width, height = max(size[0], 1), max(size[1], 1)
    masks = scene.gscore.mask_mode if scene.gscore.use_masks else "none"
    target = load_target(
        camera,
        width,
        height,
        background=background,
        mask_mode=masks,
        invert_masks=scene.gscore.invert_masks,
    )
    rendered = picture.draw(
        collect(depsgraph, final_cache),
        photo_view(camera, own, depsgraph, width, height),
        picture.Options(background=background, antialias=scene.gscore_render.antialias),
    )
    return _judged(np.clip(rendered.rgb, 0, 1), target, camera)


def _judged(shown: np.ndarray, target: Target, camera: bpy.types.Object) -> Comparison:
    photo, masked = target.pixels, None
    if target.weight is not None:
        weight = target.weight[..., None]
        squares = float((weight * (shown - photo).astype(np.float64) ** 2).sum())
        counted = 3 * float(weight.sum())
        masked = -10 * math.log10(squares / counted) if squares and counted else math.inf
        shown, photo = shown * weight, photo * weight
    error = np.abs(shown - photo).mean(axis=2)
    pictures = {"Photo": photo, "Render": shown, "Error": colorize(error * ERROR_GAIN) / 255.0}
    pictures["Comparison"] = np.concatenate(list(pictures.values()), axis=1)
    value = psnr(shown, photo)
    camera[PSNR] = value
    if masked is not None:
        camera[PSNR_MASKED] = masked
    elif PSNR_MASKED in camera:
        del camera[PSNR_MASKED]
    images = {kind: _store(kind, pictures[kind], camera.name) for kind in KINDS}
    return Comparison(psnr=value, psnr_masked=masked, images=images)


def photo_view(
    camera: bpy.types.Object,
    own: PhotoCamera,
    depsgraph: bpy.types.Depsgraph,
    width: int,
    height: int,
) -> RenderCamera:
    """An imported camera with its photo's own K in float64, at another number of pixels."""
    K = own.K.copy()
    K[0] *= width / own.width
    K[1] *= height / own.height
    placed = camera.evaluated_get(depsgraph)
    return RenderCamera(
        viewmat=rigid_viewmat(matrix_to_numpy(placed.matrix_world), camera.name),
        K=K,
        width=width,
        height=height,
        near=camera.data.clip_start,
        orthographic=False,
        name=camera.name,
    )


def _store(kind: str, pixels: np.ndarray, camera: str) -> bpy.types.Image:
    """Put [H, W, 3] sRGB values into the image for a kind of picture."""
    name = f"GS {kind}"
    height, width = pixels.shape[:2]
    image = bpy.data.images.get(name)
    if image is None:
        image = bpy.data.images.new(name, width, height)
    if tuple(image.size) != (width, height):
        image.scale(width, height)
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = pixels[::-1]
    image.pixels.foreach_set(rgba.ravel())
    image["gs_image"] = camera
    image.update()
    image.pack()  # else Blender asks whether to save it, and a file that shows it loses it
    return image
