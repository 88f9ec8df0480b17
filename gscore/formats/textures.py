"""Textures of SOG: numbers as pixels of lossless WebP, one byte per splat and channel."""

import io
import struct
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from ..errors import FormatError, GsError
from ..extras import need
from ..io.images.pillow_images import BROKEN, pillow

_MOST_SIDE = 16383
"""Most pixels of a side of a WebP."""
_SLACK = 1 << 16
"""Pixels that a texture may have in addition to four times the used ones."""
_EFFORT = {"lossless": True, "exact": True, "method": 1, "quality": 20}
"""`exact` keeps colours where alpha is zero."""


def decode_texture(what: str, raw: bytes, least: int) -> np.ndarray:
    """Decode a WebP or PNG of at least `least` pixels and not many more to [H, W, 4] uint8.

    Args:
        what: Name of the file for messages.
        raw: Its bytes.
        least: Number of used pixels.

    Raises:
        FormatError: it is neither WebP nor PNG, damaged, or of another size.
        BackendError: Pillow is not installed.
    """
    width, height = _stated_size(what, raw)
    if not least <= width * height <= 4 * least + _SLACK:
        raise FormatError(
            f"{what} has {width} x {height} pixels for {least} values, which does not fit. Copy or "
            f"export it again."
        )
    pil = _pillow()
    try:
        with pil.open(io.BytesIO(raw), formats=("WEBP", "PNG")) as image:
            if image.size != (width, height) or getattr(image, "n_frames", 1) != 1:
                raise FormatError(f"{what} is not a single picture. Export it again.")
            return np.asarray(image.convert("RGBA"))
    except GsError:
        raise
    except (*BROKEN, MemoryError, pil.UnidentifiedImageError, pil.DecompressionBombError) as error:
        raise FormatError(
            f"{what} cannot be decoded as a lossless WebP ({error}). Copy or export it again."
        ) from error


def encode_all(pictures: dict[str, np.ndarray]) -> dict[str, bytes]:
    """Encode pictures [H, W, 4] uint8 as lossless WebP, in two threads, because the encoder
    releases the GIL.

    Raises:
        BackendError: Pillow is not installed.
    """
    _pillow()
    with ThreadPoolExecutor(2, "gscore-webp") as pool:
        return dict(zip(pictures, pool.map(_encode, pictures.values()), strict=True))


def size_for(count: int) -> tuple[int, int]:
    """Width and height of a texture for `count` splats: about square, multiples of four."""
    width = max(4, -(-int(np.ceil(np.sqrt(count))) // 4) * 4)
    return width, max(4, -(-count // (width * 4)) * 4)


def fits(count: int) -> bool:
    """True if a texture can store this number of splats."""
    return max(size_for(count)) <= _MOST_SIDE


def _pillow() -> Any:
    need("PIL.Image", "SOG")
    return pillow()


def _encode(pixels: np.ndarray) -> bytes:
    file = io.BytesIO()
    pillow().fromarray(pixels, "RGBA").save(file, "WEBP", **_EFFORT)
    return file.getvalue()


def _stated_size(what: str, raw: bytes) -> tuple[int, int]:
    """Width and height from the header, checked before a decoder allocates memory."""
    try:
        if raw.startswith(b"\x89PNG\r\n\x1a\n"):
            width, height = struct.unpack_from(">II", raw, 16)
            return width, height
        if raw.startswith(b"RIFF") and raw[8:12] == b"WEBP":
            return _webp_size(raw)
    except struct.error:
        pass
    raise FormatError(f"{what} is neither WebP nor PNG, or is cut short. Copy or export it again.")


def _webp_size(raw: bytes) -> tuple[int, int]:
    kind = raw[12:16]
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", raw, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8X":
        low, middle, high, *rest = struct.unpack_from("<6B", raw, 24)
        return (low | middle << 8 | high << 16) + 1, (rest[0] | rest[1] << 8 | rest[2] << 16) + 1
    width, height = struct.unpack_from("<HH", raw, 26)
    return width & 0x3FFF, height & 0x3FFF
