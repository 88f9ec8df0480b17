"""Packing of splats to at most 20 bytes each: quantised, ordered along a curve, deflated.

Each number is quantised to an integer; bytes of one kind are stored together, so that deflate can
use their distribution. Higher SH coefficients get the rest of the budget, with the smallest step
that fits. Ascii85 makes the bytes text.
"""

import zlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..morton import distances_from_middle, morton_order
from ..sh import rgb_to_sh0, sh0_to_rgb
from ..shared_constants import ALPHA_MIN
from ..smallest_three import smallest_three, with_largest
from ..splats import PARAMETERS, Splats, cut_degree, sigmoid
from ..transforms import unit_quats

PAGE_BYTES = 20
"""Budget of text per splat, bytes."""
PAGE_DEGREE = 3
"""Highest SH degree of the scripts."""
PLACE_LEVELS = 1 << 12
"""Levels of positions along each side of the box of a block."""
TURN_LEVELS = 1 << 7
"""Levels of each of the three smaller components of a quaternion."""
_SMALLEST_LOG = np.float32(-60.0)
"""Smallest log scale."""
SIZE_STEP = 0.06
"""Step of log scales: standard deviations have errors up to 3 %."""
COLOR_STEP = 1 / 64
"""Step of the constant colour along each of `COLOR_AXES`."""
COLOR_AXES = np.array(
    [
        [3**-0.5, 3**-0.5, 3**-0.5],
        [2**-0.5, 0, -(2**-0.5)],
        [6**-0.5, -2 * 6**-0.5, 6**-0.5],
    ]
)
"""[3, 3], orthonormal rows: grey and two differences, which decorrelate colours."""
_ENDS = (np.minimum, np.maximum)
_STEPS = 0.004 * 1.15 ** np.arange(64)
"""Possible steps of higher SH coefficients; the last one removes nearly all of them."""
_SAMPLE = 256
"""Number of blocks for the first estimate of the step."""
_BRIGHTEST = np.float32(1e30)
"""Largest higher coefficient of which sums stay in range."""
_MOST = 127
"""Largest quantised value of a higher coefficient."""


@dataclass(frozen=True, kw_only=True)
class Packed:
    """Packed splats of a page."""

    head: dict[str, Any]
    """Description of the numbers as JSON: `count` and `degree` of the splats, number of `blocks`,
    levels of `places` and `turns`, and steps of the other numbers."""
    body: bytes
    """Deflated numbers."""

    @property
    def text_bytes(self) -> int:
        """Size of the body as text in the page."""
        return ascii85_length(len(self.body))


def pack(splats: Splats, *, budget: float = PAGE_BYTES) -> Packed:
    """Quantise and deflate splats. Those that are never drawn or not finite are left out; the rest
    is reordered, with SH coefficients up to `PAGE_DEGREE`.

    Args:
        splats: The splats.
        budget: Mean text per splat, bytes. Below about a thousand splats, the shared parts can need
            more.
    """
    kept = cut_degree(splats.subset(_drawn(splats)), PAGE_DEGREE)
    order, lengths = blocks_of(kept.means)
    kept = kept.subset(order)
    # Sizes are stored relative to the smallest, so sizes far below a pixel are clamped.
    kept = replace(kept, scales=np.maximum(kept.scales, _SMALLEST_LOG))
    count = len(kept)
    rest = _rest_along_axes(kept)
    head: dict[str, Any] = {
        "count": count,
        "degree": kept.sh_degree,
        "blocks": len(lengths),
        "places": PLACE_LEVELS,
        "turns": TURN_LEVELS,
        "size_low": float(kept.scales.min(initial=0.0)),
        "size_step": SIZE_STEP,
        "color_step": COLOR_STEP,
        "color_axes": COLOR_AXES.tolist(),
    }
    first = _geometry(kept, lengths) + _opacity_and_color(kept)
    room = budget * count / ascii85_length(4) * 4
    step = _step_that_fits(rest, room - len(_deflated(first)))
    while True:
        body = _deflated(first + _whole(rest, step).T.tobytes())
        if len(body) <= room or step >= _STEPS[-1]:
            return Packed(head=head | {"rest_step": step}, body=body)
        step *= 1.05


def unpack(packed: Packed) -> Splats:
    """The splats of a page, as decoded by its script."""
    head, reader = packed.head, _Reader(zlib.decompress(packed.body))
    count, blocks = head["count"], head["blocks"]
    lengths = reader.take(blocks, "u1").astype(np.intp) + 1
    boxes = reader.take(6 * blocks, "<f4").reshape(-1, 2, 3).astype(np.float64)
    places = reader.wide(3, count) / (head["places"] - 1)
    low, high = np.repeat(boxes, lengths, axis=0).transpose(1, 0, 2)
    largest, three = reader.narrow(1, count)[:, 0], reader.narrow(3, count)
    sizes = reader.wide(3, count) * head["size_step"] + head["size_low"]
    alpha = reader.narrow(1, count)[:, 0] / 255.0
    axes = np.array(head["color_axes"])
    color = reader.wide(3, count).view(np.int16) * head["color_step"] @ axes
    coefficients = (head["degree"] + 1) ** 2 - 1
    whole = reader.narrow(3 * coefficients, count).view(np.int8)
    rest = whole.reshape(count, coefficients, 3) * head["rest_step"] @ axes
    alpha = np.minimum(alpha, 1 - 1e-6)
    return Splats(
        means=(low + places * (high - low)).astype(np.float32),
        quats=_quats(largest, three, head["turns"]),
        scales=sizes.astype(np.float32),
        opacities=np.log(alpha / (1 - alpha)).astype(np.float32),
        sh0=rgb_to_sh0(color).astype(np.float32)[:, None],
        shN=rest.astype(np.float32),
    )


class _Reader:
    """Reads numbers from bytes in sequence."""

    def __init__(self, content: bytes) -> None:
        self._content, self._at = content, 0

    def take(self, count: int, dtype: str) -> np.ndarray:
        found = np.frombuffer(self._content, dtype, count, self._at)
        self._at += found.nbytes
        return found

    def narrow(self, columns: int, count: int) -> np.ndarray:
        """[count, columns] uint8."""
        return np.ascontiguousarray(self.take(columns * count, "u1").reshape(columns, count).T)

    def wide(self, columns: int, count: int) -> np.ndarray:
        """[count, columns] uint16."""
        low, high = (self.narrow(columns, count).astype(np.uint16) for _ in range(2))
        return low | high << 8


def _deflated(content: bytes) -> bytes:
    """Deflate with run-length matches only: such numbers have no other repetitions, and it is a
    hundred times as fast."""
    packer = zlib.compressobj(9, zlib.DEFLATED, 15, 9, zlib.Z_RLE)
    return packer.compress(content) + packer.flush()


def _drawn(splats: Splats) -> np.ndarray:
    """[N] bool: splats that can be visible."""
    good = np.ones(len(splats), bool)
    for name in PARAMETERS:
        numbers = getattr(splats, name)
        good &= np.isfinite(numbers).all(axis=tuple(range(1, numbers.ndim)))
    good &= np.abs(splats.quats).max(axis=1) > 1e-18
    return good & (sigmoid(splats.opacities) >= ALPHA_MIN)


def _geometry(splats: Splats, lengths: np.ndarray) -> bytes:
    """Lengths and boxes of the blocks, positions within, rotations and sizes."""
    starts = np.cumsum(lengths) - lengths
    exact = splats.means.astype(np.float64)
    low, high = (end.reduceat(exact, starts) if len(exact) else exact for end in _ENDS)
    boxes = np.stack([low, high], axis=1, dtype="<f4")
    side = np.repeat(np.maximum(high - low, 1e-30), lengths, axis=0)
    within = (exact - np.repeat(low, lengths, axis=0)) / side
    places = _rounded(within * (PLACE_LEVELS - 1), PLACE_LEVELS - 1)
    largest, three = _three_of(splats.quats)
    with np.errstate(over="ignore"):
        sizes = _rounded((splats.scales - splats.scales.min(initial=0.0)) / SIZE_STEP, 0xFFFF)
    turns = largest.astype(np.uint8).tobytes() + three.T.tobytes()
    blocks = (lengths - 1).astype(np.uint8).tobytes() + boxes.tobytes()
    return blocks + _bytes_of(places) + turns + _bytes_of(sizes)


def _opacity_and_color(splats: Splats) -> bytes:
    alpha = np.round(sigmoid(splats.opacities) * 255).astype(np.uint8)
    color = sh0_to_rgb(splats.sh0[:, 0].astype(np.float64)) @ COLOR_AXES.T
    whole = np.clip(np.round(color / COLOR_STEP), -0x8000, 0x7FFF).astype(np.int16)
    return alpha.tobytes() + _bytes_of(whole.view(np.uint16))


def _rounded(values: np.ndarray, most: int) -> np.ndarray:
    return np.clip(np.round(values), 0, most).astype(np.uint16)


def _bytes_of(whole: np.ndarray) -> bytes:
    """Columns of [N, C] uint16 in sequence: all low bytes, then all high bytes."""
    return (whole & 0xFF).astype(np.uint8).T.tobytes() + (whole >> 8).astype(np.uint8).T.tobytes()


def _three_of(quats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index [N] of the largest component, made positive, and the others [N, 3] uint8."""
    largest, three = smallest_three(unit_quats(quats))
    whole = np.round((three * 2**0.5 * 0.5 + 0.5) * (TURN_LEVELS - 1))
    return largest, np.clip(whole, 0, TURN_LEVELS - 1).astype(np.uint8)


def _quats(largest: np.ndarray, three: np.ndarray, levels: int) -> np.ndarray:
    """[N, 4] float32 unit quaternions, the inverse of `_three_of`."""
    parts = (three / (levels - 1) - 0.5) * 2**0.5
    return with_largest(largest, parts).astype(np.float32)


def _rest_along_axes(splats: Splats) -> np.ndarray:
    """[N, 3 (K - 1)] higher coefficients along `COLOR_AXES`."""
    shN = np.clip(splats.shN, -_BRIGHTEST, _BRIGHTEST)
    turned = shN @ COLOR_AXES.T.astype(np.float32)
    return turned.reshape(len(splats), 3 * splats.shN.shape[1])


def _whole(rest: np.ndarray, step: float) -> np.ndarray:
    return np.clip(np.round(rest / np.float32(step)), -_MOST, _MOST).astype(np.int8)


def _step_that_fits(rest: np.ndarray, room: float) -> float:
    """The first step at which a sample of the blocks fits into its share of `room`."""
    if not rest.size:
        return float(_STEPS[0])
    blocks = np.arange(0, len(rest), BLOCK)
    chosen = blocks[:: max(1, len(blocks) // _SAMPLE)]
    rows = np.concatenate([rest[at : at + BLOCK] for at in chosen])
    share = max(room, 0.0) * len(rows) / len(rest)
    low, high = 0, len(_STEPS) - 1
    while low < high:
        middle = (low + high) // 2
        if len(_deflated(_whole(rows, _STEPS[middle]).T.tobytes())) <= share:
            high = middle
        else:
            low = middle + 1
    return float(_STEPS[low])


ALPHABET = "".join(chr(code) for code in range(33, 127) if chr(code) not in "\"&'<>\\`")[:85]
"""Printable ASCII without characters that are special in HTML or JavaScript strings."""
_LETTERS = np.frombuffer(ALPHABET.encode(), np.uint8)
_GROUP = 4
_WEIGHTS = 85 ** np.arange(4, -1, -1, dtype=np.uint32)


def ascii85(content: bytes) -> str:
    """The bytes as Ascii85 text of `ALPHABET`, 5/4 as long, compared to 4/3 for base64.

    Four bytes are a big-endian number, written in base 85 with the highest digit first. The last
    group is padded with zero bytes; the decoder knows the length.
    """
    padded = content + bytes(-len(content) % _GROUP)
    numbers = np.frombuffer(padded, ">u4").astype(np.uint32)
    digits = numbers[:, None] // _WEIGHTS % 85
    return _LETTERS[digits].tobytes().decode()


def ascii85_length(count: int) -> int:
    """Number of characters of `ascii85` for `count` bytes."""
    return -(-count // _GROUP) * len(_WEIGHTS)


BLOCK = 256
"""Maximum number of splats of a block."""
_WIDEST = 4.0
"""Maximum side of a box, relative to a distance from the middle of all splats: that of the nearest
splat of the block, or the median of all splats if larger."""


def blocks_of(means: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """An order [N] of positions [N, 3], and the lengths of its blocks [B], 1 to 256, with sum N.

    Each is an interval of 256 along a Morton curve, split at its widest gaps if its box would be so
    large that quantised positions become coarse. A single far splat does not affect its neighbours.
    """
    order = morton_order(means)
    away, usual = distances_from_middle(means)
    starts = np.arange(0, len(means), BLOCK)
    if not len(starts):
        return order, starts
    sorted_means = means[order].astype(np.float64)
    low = np.minimum.reduceat(sorted_means, starts)
    side = (np.maximum.reduceat(sorted_means, starts) - low).max(axis=1)
    nearest = np.minimum.reduceat(away[order], starts)
    loose = side > _WIDEST * np.maximum(nearest, usual)
    lengths: list[int] = []
    for start, cut in zip(starts.tolist(), loose.tolist(), strict=True):
        rows = order[start : start + BLOCK]
        parts = _tight(rows, means, away, usual) if cut else [rows]
        order[start : start + BLOCK] = np.concatenate(parts)
        lengths += map(len, parts)
    return order, np.array(lengths)


def _tight(rows: np.ndarray, means: np.ndarray, away: np.ndarray, usual: float) -> list[np.ndarray]:
    """The rows split into parts with small boxes, in the order of the curve within each."""
    left, found = [rows], []
    while left:
        part = left.pop()
        places = means[part].astype(np.float64)
        sides = np.ptp(places, axis=0)
        if sides.max() <= _WIDEST * max(away[part].min(), usual):
            found.append(part)
            continue
        along = places[:, sides.argmax()]
        steps = np.sort(along)
        first_beyond = steps[np.diff(steps).argmax() + 1]
        left += [part[along >= first_beyond], part[along < first_beyond]]
    return found
