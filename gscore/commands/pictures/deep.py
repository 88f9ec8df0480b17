"""Deep pictures: colour, alpha and depth of each pixel in layers, for compositors such as Nuke."""

import tempfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from ...extras import need
from ...io.files import atomic_write
from ...io.images.pixels import srgb_to_linear
from ...raster.api import Rendered

LAYERS = 32
"""Layers of a picture, so at most as many samples a pixel."""
_LEAST = 1 / 1024
"""Share of a pixel below which a sample is left out; without this most samples are hidden ones."""


def need_deep() -> None:
    """Raise BackendError unless OpenEXR is installed."""
    need("OpenEXR", "Writing deep pictures")


def layer_bounds(
    means: np.ndarray, K: np.ndarray, viewmat: np.ndarray, width: int, height: int, near: float
) -> np.ndarray:
    """Depths between which a layer's splats have their centres; as many splats in each.

    Splats are blended in the order of their centres' depths, so layers drawn one by one and put
    over each other are the whole picture.

    Args:
        means: [N, 3], world.
        K: [3, 3] intrinsics, px.
        viewmat: [4, 4] world to camera, OpenCV axes.
        width: Of the picture, px.
        height: Of the picture, px.
        near: Near plane, world units.

    Returns:
        [B] float64, rising, from `near` to beyond all splats; world units.
    """
    x, y, z = viewmat[:3, :3] @ means.T.astype(np.float64) + viewmat[:3, 3:]
    front = z > near
    u, v = (K[i, i] * at[front] / z[front] + K[i, 2] for i, at in enumerate((x, y)))
    inside = z[front][(u >= 0) & (u < width) & (v >= 0) & (v < height)]
    inner = np.quantile(inside, np.arange(1, LAYERS) / LAYERS) if len(inside) else []
    return np.unique(np.concatenate([[near], inner, [1e10]]))


def deep_channels(
    flat: Rendered, layers: Iterable[Rendered], background: tuple[float, float, float]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Samples of a picture in linear light.

    The colours of a pixel's samples are scaled so that these, put over each other, are the linear
    colour of `flat`: splats are blended in the encoding of the photos, where the same weights give
    another colour.

    Args:
        flat: The picture.
        layers: Its layers over black with `depth`, near ones first; exposed or not.
        background: What `flat` was drawn over.

    Returns:
        [H, W] int64, samples per pixel, and by channel [S] float32, pixel by pixel, near ones
        first: R, G, B (linear sRGB primaries, premultiplied), A, and Z (z, world units).
    """
    height, width = flat.alpha.shape
    pixels, values = [], []
    through = np.ones(height * width)
    blended = np.zeros((height * width, 3))
    for layer in layers:
        alpha = layer.alpha.reshape(-1)
        at = np.flatnonzero(alpha * through > _LEAST)
        part, depth = alpha[at, None], np.asarray(layer.depth).reshape(-1)[at, None]
        light = srgb_to_linear(layer.rgb.reshape(-1, 3)[at] / part) * part
        blended[at] += through[at, None] * light
        through[at] *= 1 - part[:, 0]
        pixels.append(at)
        values.append(np.concatenate([light, part, depth], axis=1, dtype=np.float32))
    coverage = flat.alpha[..., None]
    own = flat.rgb - np.array(background, np.float32) * (1 - coverage)
    straight = np.divide(own, coverage, out=np.zeros_like(own), where=coverage > 0)
    light = (srgb_to_linear(np.maximum(straight, 0)) * coverage).reshape(-1, 3)
    scale = np.divide(light, blended, out=np.ones_like(blended), where=blended > 0)
    found, samples = np.concatenate(pixels), np.concatenate(values)
    samples[:, :3] *= scale[found]
    order = np.argsort(found, kind="stable")
    counts = np.bincount(found, minlength=height * width).reshape(height, width)
    return counts, dict(zip("RGBAZ", samples[order].T, strict=True))


def write_deep(path: Path, counts: np.ndarray, channels: dict[str, np.ndarray]) -> None:
    """Write a deep OpenEXR file (scan lines, ZIPS).

    Args:
        path: The file.
        counts: [H, W], samples per pixel.
        channels: [S] float32 by name, pixel by pixel; all but Z are written as 16-bit floats.
    """
    OpenEXR = need("OpenEXR", "Writing deep pictures")
    ends = np.cumsum(counts.reshape(-1))[:-1]
    pixels = {}
    for name, samples in channels.items():
        stored = np.ascontiguousarray(samples, np.float16 if name in "RGBA" else np.float32)
        parts = np.fromiter(np.split(stored, ends), dtype=object, count=counts.size)
        pixels[name] = parts.reshape(counts.shape)
    header = {"compression": OpenEXR.ZIPS_COMPRESSION, "type": OpenEXR.deepscanline}
    with tempfile.TemporaryDirectory() as folder:  # the library writes to paths only
        written = Path(folder) / "deep.exr"
        OpenEXR.File(header, pixels).write(str(written))
        atomic_write(path, written.read_bytes())
