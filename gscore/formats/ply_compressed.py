"""Compressed PLY of SuperSplat, reader and writer: 256 splats per chunk, 16 bytes each.

Source: the public layout, see `gscore.io.ply.compressed`. Splats are quantised within the bounds of
their chunk, so they are written in the order of a space-filling curve: nearby splats get finer
steps.
"""

from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..importance import importance_of
from ..io.files import atomic_write
from ..io.ply.compressed import CHUNK
from ..io.ply.elements import header_bytes
from ..io.ply.splats import is_antialiased_ply
from ..io.splat_rows import opacity_bytes
from ..morton import distances_from_middle, morton_order
from ..sh import SH_C0, sh0_to_rgb
from ..smallest_three import smallest_three
from ..splats import Splats
from ..text_format import count_text
from ..transforms import unit_quats
from . import ply
from .far_splats import FAR, cut_extremes, moved_within
from .splat_file import SplatFormat, WriteOptions

_BOUNDS = [
    *(f"{end}_{axis}" for end in ("min", "max") for axis in "xyz"),
    *(f"{end}_scale_{axis}" for end in ("min", "max") for axis in "xyz"),
    *(f"{end}_{axis}" for end in ("min", "max") for axis in "rgb"),
]
_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_LARGEST_LOG = 20.0
_LARGEST_COLOR = 4.0 / SH_C0
"""Largest sh0 coefficient: the colours of a chunk have 256 values between its bounds."""
_REACH = 4.0
"""Largest SH coefficient beyond degree 0."""
_CHUNKS_A_BLOCK = 1 << 10
_PLACE_BITS = (11, 10, 11)
_MOST_MOVED = 1 / 100
"""Largest displacement that is not reported, as a share of the distance from the middle, or of the
median distance if that is larger. A chunk that spans all near splats has 1 / 128."""


def _write(path: Path, splats: Splats, options: WriteOptions) -> list[str]:
    order, near = _order(splats)
    splats, notes = _limited(splats, order, near)
    chunks = -(-len(splats) // CHUNK)
    rest = 3 * splats.shN.shape[1]
    lines = [line for text in ply.comments_of(options) for line in text.splitlines()]
    header = ["format binary_little_endian 1.0", *(f"comment {line}" for line in lines)]
    header += [f"element chunk {chunks}", *(f"property float {name}" for name in _BOUNDS)]
    header += [f"element vertex {len(splats)}", *(f"property uint {name}" for name in _PACKED)]
    if rest:
        header += [f"element sh {len(splats)}"]
        header += [f"property uchar f_rest_{k}" for k in range(rest)]
    text = header_bytes(header)
    packed = [
        _pack(splats.subset(order[at : at + _CHUNKS_A_BLOCK * CHUNK]))
        for at in range(0, len(splats), _CHUNKS_A_BLOCK * CHUNK)
    ]

    def write(file: BinaryIO) -> None:
        file.write(text)
        for element in range(3):
            file.writelines(parts[element] for parts in packed)

    atomic_write(path, write)
    return notes + _notes(splats, order)


def _order(splats: Splats) -> tuple[np.ndarray, int]:
    """Indices [N] along a Morton curve, and the number of near splats. Splats far from all others
    come last, in order of distance, so that the chunks of the near ones stay small.

    Usually one chunk has splats of both kinds; its near splats are the least visible ones.
    """
    order = morton_order(splats.means)
    away, usual = distances_from_middle(splats.means)
    level = np.ceil(np.log2(np.maximum(away[order] / (FAR * usual), 1))).astype(np.int16)
    order, level = order[np.argsort(level, kind="stable")], np.sort(level)
    near = order[level == 0]
    odd = len(near) % CHUNK
    if len(near) == len(order) or not odd:
        return order, len(near)
    importance = importance_of(splats.subset(near))
    least = np.zeros(len(near), bool)
    least[np.argpartition(importance, odd - 1)[:odd]] = True
    return np.concatenate([near[~least], near[least], order[len(near) :]]), len(near)


def _limited(splats: Splats, order: np.ndarray, near: int) -> tuple[Splats, list[str]]:
    """The splats, with far ones in a chunk of near ones moved nearer, and colours clipped to
    `_LARGEST_COLOR`, so that no splat coarsens the others of its chunk; and notes on both."""
    notes = []
    strays = order[near : -(-near // CHUNK) * CHUNK]
    if len(strays):
        away, usual = distances_from_middle(splats.means)
        moved = np.zeros(len(splats), bool)
        moved[strays] = True
        splats = moved_within(splats, moved, away, FAR * usual)
        notes.append(
            f"{count_text(len(strays), 'splat')} up to {away[strays].max():.3g} units away from "
            f"the others were moved to {FAR * usual:.3g} units and made smaller: they share their "
            f"chunk with others. Remove far splats first, with gscore convert --box or --sphere."
        )
    splats, cut = cut_extremes(splats, "sh0", _LARGEST_COLOR)
    if cut:
        notes.append(f"{count_text(cut, 'splat')} had colours beyond -3.5 to 4.5, cut to that.")
    return splats, notes


def _notes(splats: Splats, order: np.ndarray) -> list[str]:
    """Notes on displaced splats and clipped coefficients."""
    notes = []
    moved = _displacements(splats.means[order])
    away, usual = distances_from_middle(splats.means)
    beyond = moved > _MOST_MOVED * np.maximum(away[order], usual)
    if beyond.any():
        notes.append(
            f"{count_text(int(beyond.sum()), 'splat')} share their chunk with others far away, "
            f"and were moved by up to {moved[beyond].max():.3g} units. Remove far splats "
            f"first, with gscore convert --box or --sphere."
        )
    wide = int((np.abs(splats.shN) > _REACH).any(axis=(1, 2)).sum())
    if wide:
        notes.append(
            f"{count_text(wide, 'splat')} had SH coefficients beyond -4 to 4, cut to that."
        )
    return notes


def _displacements(means: np.ndarray) -> np.ndarray:
    """[N] float64, world units: largest rounding error of each position along one axis."""
    starts = np.arange(0, len(means), CHUNK)
    if not len(starts):
        return np.zeros(0)
    exact = means.astype(np.float64)
    side = np.maximum.reduceat(exact, starts) - np.minimum.reduceat(exact, starts)
    steps = side / (2.0 ** np.array(_PLACE_BITS) - 1)
    return np.repeat(steps.max(axis=1) / 2, CHUNK)[: len(means)]


def _pack(part: Splats) -> tuple[bytes, bytes, bytes]:
    """Bytes of the elements chunk, vertex and sh; only the last chunk may be partial."""
    count = len(part)
    scales = np.clip(part.scales, -_LARGEST_LOG, _LARGEST_LOG)
    places, place_ends = _within_chunks(part.means)
    sizes, size_ends = _within_chunks(scales)
    colors, color_ends = _within_chunks(sh0_to_rgb(part.sh0[:, 0]))
    rows = np.empty((count, 4), "<u4")
    rows[:, 0] = _fields(places, _PLACE_BITS)
    rows[:, 1] = _pack_rotations(part.quats)
    rows[:, 2] = _fields(sizes, (11, 10, 11))
    rows[:, 3] = _fields(colors, (8, 8, 8)) << np.uint32(8) | opacity_bytes(part.opacities)
    bounds = np.concatenate([place_ends, size_ends, color_ends], axis=1).astype("<f4")
    by_channel = part.shN.transpose(0, 2, 1).reshape(count, -1)
    with np.errstate(over="ignore"):
        rest = np.clip((by_channel / (2 * _REACH) + 0.5) * 256, 0, 255).astype(np.uint8)
    return bounds.tobytes(), rows.tobytes(), rest.tobytes()


def _within_chunks(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[N, 3] from 0 to 1 within the bounds of a chunk, and the bounds [chunks, 6], lower first."""
    count = len(values)
    padded = np.pad(values.astype(np.float64), ((0, -count % CHUNK), (0, 0)), mode="edge")
    grouped = padded.reshape(-1, CHUNK, 3)
    low, high = grouped.min(axis=1), grouped.max(axis=1)
    width = np.where(high > low, high - low, 1)
    return ((grouped - low[:, None]) / width[:, None]).reshape(-1, 3)[:count], np.concatenate(
        [low, high], axis=1
    )


def _fields(values: np.ndarray, bits: tuple[int, int, int]) -> np.ndarray:
    """[N] uint32: numbers [N, 3] from 0 to 1 as bit fields, the first one highest."""
    out = np.zeros(len(values), np.uint32)
    for k, width in enumerate(bits):
        field = np.rint(values[:, k] * ((1 << width) - 1)).astype(np.uint32)
        out = out << np.uint32(width) | field
    return out


def _pack_rotations(quats: np.ndarray) -> np.ndarray:
    """[N] uint32: 2 bits for the index of the largest of w, x, y, z, 10 bits for each other."""
    largest, three = smallest_three(unit_quats(quats))
    parts = three * np.sqrt(0.5) + 0.5
    fields = _fields(np.clip(parts, 0, 1), (10, 10, 10))
    return largest.astype(np.uint32) << np.uint32(30) | fields


COMPRESSED_PLY = SplatFormat(
    key="compressed-ply",
    name="SuperSplat's compressed PLY",
    endings=(".compressed.ply",),
    recognizes=lambda path, sample: ply.is_ply(path, sample) and b" packed_position" in sample.head,
    read=lambda path: replace(ply.read(path), layout="compressed (SuperSplat)"),
    write=_write,
    is_antialiased=is_antialiased_ply,
    file_origin=ply.origin_of_ply,
)
