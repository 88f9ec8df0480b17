"""Video encoder: MP4 files from pictures, through PyAV."""

import os
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import BackendError, GsError
from ...extras import missing, package_facts
from ...io.files import reason

_ENCODERS = ("libx264", "libopenh264", "h264_videotoolbox", "mpeg4")
"""Tried in this order; the first two and the last are software."""


def need_video() -> Any:
    """The module of PyAV.

    Raises:
        BackendError: PyAV is not installed.
    """
    try:
        import av
    except ImportError as error:
        raise BackendError(
            f"{missing('av', 'Writing a video')}. Or give a folder with -o to get PNG files.",
            **package_facts("av"),
        ) from error
    return av


def write_video(path: Path, pictures: Iterable[np.ndarray], *, fps: float) -> None:
    """Write an H.264 file completely or not at all.

    Args:
        path: The file, `.mp4`.
        pictures: [H, W, 3] uint8 each, all of one size, H and W even.
        fps: Pictures per second.

    Raises:
        BackendError: PyAV or a usable encoder is missing.
        GsError: The file cannot be written.
    """
    av = need_video()
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Without "file:", FFmpeg parses text before a colon as a protocol, such as tcp or concat.
        options = {"movflags": "+faststart"}
        with av.open(f"file:{temporary}", "w", format="mp4", options=options) as file:
            file.metadata["comment"] = "Rendered by gscore"
            stream = None
            for picture in pictures:
                if stream is None:
                    stream = _stream(av, file, picture.shape[1], picture.shape[0], fps)
                frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
                # Players assume BT.709 for HD video; declare and use it at every size.
                frame = frame.reformat(format="yuv420p", dst_colorspace="ITU709")
                for packet in stream.encode(frame):
                    file.mux(packet)
            if stream is not None:
                for packet in stream.encode():
                    file.mux(packet)
        temporary.replace(path)
    except OSError as error:
        raise GsError(f"Cannot write {path}: {reason(error)}") from error
    finally:
        temporary.unlink(missing_ok=True)


def _stream(av: Any, file: Any, width: int, height: int, fps: float) -> Any:
    """A video stream of the best available encoder."""
    name = next((n for n in _ENCODERS if n in av.codecs_available), None)
    if name is None:
        raise BackendError(
            f"The installed av {av.__version__} has no encoder for MP4 (none of "
            f"{', '.join(_ENCODERS)}); install another build, or write PNG files."
        )
    stream = file.add_stream(name, rate=Fraction(fps).limit_denominator(1001))
    stream.width, stream.height = width, height
    stream.pix_fmt = "yuv420p"  # the only layout that every player supports
    if name == "libx264":
        stream.options = {"crf": "18", "preset": "medium"}
    else:
        stream.bit_rate = int(0.15 * width * height * fps)
    context = stream.codec_context
    context.color_primaries, context.color_trc, context.colorspace, context.color_range = 1, 1, 1, 1
    return stream
