"""Small videos: a camera that passes a textured wall, with optional blur and repeated frames."""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

WIDTH, HEIGHT = 480, 272


def wall(width: int = 2600, height: int = 400, seed: int = 0) -> np.ndarray:
    """[height, width, 3] uint8: noise of several sizes, so that blur of any length is detectable;
    fine noise is grey, because video stores colours at half the resolution."""
    rng = np.random.default_rng(seed)
    total = np.zeros((height, width, 3), np.float32)
    for size in (1, 2, 4, 8, 16, 32):
        channels = 3 if size >= 8 else 1
        coarse = rng.normal(size=(-(-height // size), -(-width // size), channels))
        coarse = coarse.repeat(size, 0).repeat(size, 1)
        total += (coarse[:height, :width] * (size + 3) ** 0.5).astype(np.float32)
    return np.clip(128 + total * 11, 0, 255).astype(np.uint8)


def seen(texture: np.ndarray, x: float, *, blur: int = 1) -> np.ndarray:
    """[HEIGHT, WIDTH, 3] uint8 from place x on, the mean over `blur` pixels of the path."""
    total = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    for step in range(blur):
        begin = round(x) + step
        total += texture[40 : 40 + HEIGHT, begin : begin + WIDTH]
    return (total / blur + 0.5).astype(np.uint8)


def write(
    path: Path,
    pictures: Iterable[np.ndarray],
    *,
    times: Sequence[float] | None = None,
    codec: str = "libx264",
    pix_fmt: str = "yuv420p",
    rate: int = 30,
    options: dict[str, str] | None = None,
    muxer: dict[str, str] | None = None,
    aspect: Fraction | None = None,
    color: tuple[int, int, int] | None = None,
    source: str = "rgb24",
    interlaced: bool = False,
    comment: str = "",
) -> Path:
    """A video of pictures; `times` in seconds instead of a constant rate, `color` the numbers of
    H.273 for primaries, transfer and matrix."""
    with av.open(f"file:{path}", "w", options=muxer or {}) as file:
        stream: Any = None
        if comment:
            file.metadata["comment"] = comment
        for index, picture in enumerate(pictures):
            if stream is None:
                stream = file.add_stream(
                    codec, rate=rate, options=options or {"crf": "12", "preset": "veryfast"}
                )
                stream.height, stream.width = picture.shape[:2]
                stream.pix_fmt = pix_fmt
                stream.codec_context.time_base = Fraction(1, 1000 if times else rate)
                if aspect:
                    stream.codec_context.sample_aspect_ratio = aspect
                if color:
                    context = stream.codec_context
                    context.color_primaries, context.color_trc, context.colorspace = color
                    context.color_range = 1
                if interlaced:
                    stream.codec_context.flags |= 1 << 18 | 1 << 29
            frame = av.VideoFrame.from_ndarray(picture, format=source)
            if source == "rgb24":
                matrix = "ITU601" if picture.shape[0] < 720 else "ITU709"
                frame = frame.reformat(format=pix_fmt, dst_colorspace=matrix)
            frame.pts = round(times[index] * 1000) if times else index
            frame.time_base = Fraction(1, 1000 if times else rate)
            for packet in stream.encode(frame):
                file.mux(packet)
        for packet in stream.encode():
            file.mux(packet)
    return path


def walk(count: int = 120, step: float = 8.0) -> list[np.ndarray]:
    """A sharp walk along the wall, `step` pixels a frame."""
    texture = wall(round(count * step) + WIDTH + 80)
    return [seen(texture, i * step) for i in range(count)]
