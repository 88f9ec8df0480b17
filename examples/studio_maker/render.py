"""Render colour, soft mask and exact depth of a view with Cycles."""

import sys
from pathlib import Path

import bpy
import numpy as np

from .blender import MASK


def configure(width, height, samples, threads):
    """Configure the scene for `picture`."""
    scene = bpy.context.scene
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    cycles.device = "CPU"
    cycles.samples = samples
    cycles.use_adaptive_sampling = True
    cycles.adaptive_threshold, cycles.adaptive_min_samples = 0.05, min(samples, 8)
    cycles.use_denoising = True
    cycles.denoiser = "OPENIMAGEDENOISE"
    cycles.denoising_input_passes = "RGB_ALBEDO_NORMAL"
    cycles.denoising_prefilter = "FAST"
    cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 4, 3, 2
    cycles.sample_clamp_indirect = 4.0
    cycles.seed = 0
    render.use_persistent_data = True
    render.threads_mode, render.threads = ("FIXED", threads) if threads else ("AUTO", 1)
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    layer = bpy.context.view_layer
    layer.use_pass_z = True
    mask = layer.aovs.add()
    mask.name, mask.type = MASK, "VALUE"
    # A multilayer file needs no compositor, whose API changed between Blender 4 and 5; Blender 5
    # only requires the media type first.
    if hasattr(render.image_settings, "media_type"):
        render.image_settings.media_type = "MULTI_LAYER_IMAGE"
    render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    render.image_settings.color_depth = "32"


def picture(path, gain=1.0):
    """Render the current camera to a temporary file `path`.exr, with linear colours times `gain`.

    Returns:
        rgb [H, W, 3] sRGB in [0, 1]; mask [H, W] coverage by the figure; depth [H, W] along the
        optical axis at pixel centres in metres, infinite where a ray hits nothing.
    """
    rgb, mask, depth = linear_picture(path)
    return exposed(rgb, gain), mask, depth


def linear_picture(path):
    """As `picture`, with rgb in linear Rec. 709, not limited to 1."""
    path = Path(path).with_suffix(".exr")
    bpy.context.scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    channels = read_exr(path)
    path.unlink()
    rgb = np.stack([find(channels, "Combined." + c) for c in "RGB"], -1)
    depth = find(channels, "Depth.Z", "Depth.V")
    mask = find(channels, MASK + ".X", MASK + ".V", MASK + ".Value")
    return rgb, np.clip(mask, 0, 1), np.where(depth < 1e9, depth, np.inf)


def exposed(rgb, gain=1.0):
    """sRGB in [0, 1] of linear colours times `gain`, clipped as a camera's are."""
    rgb = np.clip(rgb * gain, 0, 1)
    return np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1 / 2.4) - 0.055)


def find(channels, *endings):
    """The first channel with one of these name endings."""
    for ending in endings:
        for name, values in channels.items():
            if name.endswith(ending):
                return values
    raise KeyError(f"The render has no channel {' or '.join(endings)}, only {', '.join(channels)}.")


def read_exr(path):
    """Channels of all parts of a file by name, each [H, W] float32, rows from the top."""
    here = Path(bpy.utils.resource_path("LOCAL")) / "python" / "lib"
    sys.path.extend(str(p) for p in here.glob("python*/site-packages") if str(p) not in sys.path)
    import OpenImageIO

    file = OpenImageIO.ImageInput.open(str(path))
    channels, part = {}, 0
    while file.seek_subimage(part, 0):
        spec = file.spec()
        values = np.asarray(file.read_image(part, 0, 0, spec.nchannels, "float"))
        values = values.reshape(spec.height, spec.width, spec.nchannels)
        channels |= {name: values[..., i] for i, name in enumerate(spec.channelnames)}
        part += 1
    file.close()
    return channels
