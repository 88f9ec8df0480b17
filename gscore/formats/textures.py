"""Textures of SOG: numbers as pixels of lossless WebP, one byte per splat and channel."""

import io
import struct
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from ..errors import FormatError, GsError
from ..extras import need
from ..io.images.pillow_images import BROKEN, pillow

CODEBOOK_SIZE = 256
"""Numbers of a codebook."""
MOST_ROWS = 1 << 16
"""Most rows of a palette."""
_BINS, _BINS_A_GUESS = 1 << 14, 1 << 5
_ROUNDS = 20
_SAMPLED = 200_000
_FEW = 1024
_MOST_ERROR = 0.02
"""Largest RMS error of SH coefficients in a short palette, if a full one is possible."""


def codebook(values: np.ndarray) -> np.ndarray:
    """[256] float32 ascending: least-squares codebook of `values` (Lloyd 1982, Max 1960).

    Starts with the solution for fine steps, whose density is the cube root of that of the values;
    iterates on a histogram.
    """
    values = values.ravel()
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 0.0)
    if not high > low:
        return np.full(CODEBOOK_SIZE, low, np.float32)
    counts, edges = np.histogram(values, _BINS, (low, high))
    middles = (edges[:-1] + edges[1:]) / 2
    amount = np.concatenate([[0.0], np.cumsum(counts)])
    moment = np.concatenate([[0.0], np.cumsum(counts * middles)])
    # Wider bins, because in the tails fine ones have one value or none, a poor density estimate.
    density = counts.reshape(-1, _BINS_A_GUESS).sum(axis=1)
    share = np.cumsum(np.repeat(np.cbrt(density), _BINS_A_GUESS) + 1e-9)
    at = np.searchsorted(share, (np.arange(CODEBOOK_SIZE) + 0.5) / CODEBOOK_SIZE * share[-1])
    book = middles[np.minimum(at, _BINS - 1)]
    for _ in range(_ROUNDS):
        borders = np.searchsorted(middles, (book[1:] + book[:-1]) / 2)
        borders = np.concatenate([[0], borders, [_BINS]])
        members = np.diff(amount[borders])
        means = np.diff(moment[borders]) / np.maximum(members, 1)
        book = np.where(members > 0, means, book)
    return np.sort(book).astype(np.float32)


def nearest_entries(book: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Indices of the nearest entries of an ascending codebook, uint8, of the shape of `values`."""
    return np.searchsorted((book[1:] + book[:-1]) / 2, values).astype(np.uint8)


def palette(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Palette that approximates all rows, and the index of each row in it: a quarter to a half of
    the rows, 65,536 at most; all rows for 1,024 or fewer, or if a shorter palette would lose much.

    The rows are halved repeatedly at the median of a principal component, so that groups have equal
    sizes; the palette has the mean of each group. The component of each halving is the same for all
    groups: the one with the largest remaining variance.

    Args:
        rows: [N, D] float32.

    Returns:
        The palette [P, D] float32 and labels [N] uint16.
    """
    count = len(rows)
    if count <= _FEW:
        return rows, np.arange(count, dtype=np.uint16)
    groups = min(MOST_ROWS, 1 << ((count // 2).bit_length() - 1))
    order = np.arange(count)
    each = -(-count // groups)
    # Groups of one size make each halving one call; the last rows are repeated to fill them.
    order = np.concatenate([order, order[: each * groups - count]])
    axes, plan = _halvings(rows, groups)
    for level, component in enumerate(plan):
        values = rows @ axes[:, component]
        grouped = order.reshape(1 << level, -1)
        half = grouped.shape[1] // 2
        split = np.argpartition(values[grouped], half, axis=1)
        order = np.take_along_axis(grouped, split, axis=1).ravel()
    means, labels = _means(rows, order.reshape(groups, each), count)
    error = float(np.sqrt(np.mean((means[labels] - rows) ** 2, dtype=np.float64)))
    if error > _MOST_ERROR and count <= MOST_ROWS:
        return rows, np.arange(count, dtype=np.uint16)
    return means, labels


def _halvings(rows: np.ndarray, groups: int) -> tuple[np.ndarray, list[int]]:
    """Principal axes [D, D] as columns, and the index of the one that each halving uses."""
    some = rows[:: max(1, len(rows) // _SAMPLED)].astype(np.float64)
    variances, axes = np.linalg.eigh(np.cov(some, rowvar=False))
    left, plan = variances.copy(), []
    for _ in range(groups.bit_length() - 1):
        plan.append(int(left.argmax()))
        left[plan[-1]] /= 4
    return axes.astype(np.float32), plan


def _means(rows: np.ndarray, members: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Means of the groups [P, K] of rows, and the group of each row."""
    means = np.empty((len(members), rows.shape[1]), np.float32)
    for column in range(rows.shape[1]):
        means[:, column] = rows[:, column][members].mean(axis=1)
    labels = np.empty(count, np.uint16)
    labels[members.ravel()] = np.repeat(np.arange(len(members), dtype=np.uint16), members.shape[1])
    return means, labels


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
