"""A photo beside what the splats show from its camera: pictures, and the PSNR."""

from dataclasses import dataclass

import bpy
import numpy as np

from .. import camera_math as cm
from ..camera_objects import PhotoCamera, is_camera, rigid_viewmat, stated
from ..cameras import RenderCamera
from ..compat import matrix_to_numpy
from ..core import colorize, downscale, psnr
from . import color, picture
from .engine import background_of, collect, final_cache, world_light

ERROR_GAIN = 4.0
"""Error pictures show this times the mean absolute difference of the channels, as gscore's do."""
PSNR = "gs_psnr"
"""Custom property of a camera: the PSNR of the last comparison, dB."""
KINDS = ("Photo", "Render", "Error", "Comparison")
"""Pictures that are made; Comparison has the others side by side."""
_PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE")


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """What `compare` found."""

    psnr: float
    """dB, of the splats' picture against the photo, on sRGB values; inf if they are equal."""
    images: dict[str, bpy.types.Image]
    """By the names in `KINDS`."""


def compare(
    scene: bpy.types.Scene, camera: bpy.types.Object, depsgraph: bpy.types.Depsgraph
) -> Comparison:
    """Render from an imported camera and compare with its photo.

    The picture has the photo's size times the scene's resolution percentage, whatever the scene's
    resolution; the photo is scaled to that as it is for training. Transparent photos are put over
    the world's colour, as the splats are.

    Args:
        scene: Gives percentage, world and settings, and receives nothing.
        camera: Of an imported capture; it is where it stands now. Receives `PSNR`.
        depsgraph: What is visible in it is drawn.

    Raises:
        ValueError: no such camera, a distorted one, no splats, or no photo.
        GsError: the native library is missing.
    """
    if not is_camera(camera):
        raise ValueError(
            f"{camera.name} is no camera of a photo: choose one that Import Capture made."
        )
    own = stated(camera)
    if own.model not in _PINHOLES:
        raise ValueError(
            f"The lens of {own.image} is distorted ({own.model}), the splats are seen through an "
            f"ideal one: import the capture as COLMAP's image_undistorter leaves it to compare."
        )
    background = background_of(world_light(scene.world)[0])
    width, height = cm.frame_size(own.width, own.height, scene.render.resolution_percentage)
    photo = photo_pixels(own, max(width, 1), max(height, 1), background)
    rendered = picture.draw(
        collect(depsgraph, final_cache),
        photo_view(camera, own, depsgraph, photo.shape[1], photo.shape[0]),
        picture.Options(background=background, antialias=scene.gscore_render.antialias),
    )
    shown = np.clip(rendered.rgb, 0, 1)
    error = np.abs(shown - photo).mean(axis=2)
    pictures = {"Photo": photo, "Render": shown, "Error": colorize(error * ERROR_GAIN) / 255.0}
    pictures["Comparison"] = np.concatenate(list(pictures.values()), axis=1)
    value = psnr(shown, photo)
    camera[PSNR] = value
    return Comparison(
        psnr=value, images={kind: _store(kind, pictures[kind], camera.name) for kind in KINDS}
    )


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


def photo_pixels(
    own: PhotoCamera, width: int, height: int, background: tuple[float, float, float]
) -> np.ndarray:
    """A camera's photo as [height, width, 3] float32 sRGB values, the top row first.

    Raises:
        ValueError: it is not there, cannot be decoded, or has another shape than the camera.
    """
    path = bpy.path.abspath(own.photo)
    try:
        image = bpy.data.images.load(path, check_existing=False)
    except RuntimeError as error:
        raise ValueError(
            f"The photo {path} cannot be read: find the capture's folder again."
        ) from error
    try:
        pixels = _decoded(image, path)
    finally:
        bpy.data.images.remove(image)
    # Copies of a photo at other sizes (images_2) are rounded to whole pixels.
    if abs(pixels.shape[1] * own.height - pixels.shape[0] * own.width) > own.width + own.height:
        raise ValueError(
            f"The photo {path} is {pixels.shape[1]} x {pixels.shape[0]} pixels, its camera was "
            f"made for {own.width} x {own.height}: find the photo that COLMAP saw."
        )
    alpha = pixels[..., 3:]
    over = pixels[..., :3] * alpha + np.array(background, np.float32) * (1 - alpha)
    levels = (np.clip(over, 0, 1) * 255 + 0.5).astype(np.uint8)
    # A scene above 100 % asks for more pixels than the photo has.
    if width > levels.shape[1] or height > levels.shape[0]:
        raise ValueError(
            f"The photo {path} has {levels.shape[1]} x {levels.shape[0]} pixels, {width} x "
            f"{height} are asked for: lower the scene's resolution percentage."
        )
    return downscale(levels, width, height) / np.float32(255)


def _decoded(image: bpy.types.Image, path: str) -> np.ndarray:
    """[H, W, 4] float32, straight alpha, sRGB values, the top row first."""
    width, height = image.size
    if not width * height or image.channels not in (1, 3, 4):
        raise ValueError(f"The photo {path} is no picture that Blender can decode.")
    flat = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(flat)
    found = flat.reshape(height, width, image.channels)[::-1]
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., : 3 if image.channels == 1 else image.channels] = found
    if image.is_float:  # 16 bits and more are decoded to linear light, bytes are left as they are
        pixels[..., :3] = color.encode(pixels[..., :3])
    return pixels


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
    return image
