"""SOG writer: textures of one byte per value, and meta.json with its property names.

Source: see sog.py.
"""

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from .._version import __version__
from ..errors import ConfigError
from ..io.files import atomic_write
from ..io.splat_rows import opacity_bytes
from ..morton import morton_order
from ..smallest_three import smallest_three
from ..splats import Splats
from ..text_format import count_text
from ..transforms import unit_quats
from . import textures
from .far_splats import cut_extremes, without_far
from .parts import write_parts
from .splat_file import ORIGIN, WriteOptions
from .textures import codebook, nearest_entries, palette

META = "meta.json"
PALETTE_WIDTH = 64
"""Palette rows per line of its texture."""
SECTIONS = ("means", "scales", "quats", "sh0", "shN")
"""Sections of a meta.json with files."""
_OF_SH = ("shN_centroids.webp", "shN_labels.webp")
"""Textures that models of SH degree 0 lack."""
CHECKS = "crc32"
"""Key in the asset of a meta.json: CRC-32 of each texture file."""
FIRST_TAG = 252
ANTIALIASED = "antialiased"
"""Model kind written by splat-transform; older versions wrote `antialias`."""
_FINE = 2.0**-11
"""Step of positions that is fine enough, for `without_far`."""
_LARGEST = {"scales": 80.0, "sh0": 16.0, "shN": 4.0}
"""Largest log scales and SH coefficients, because extremes make the shared codebooks coarse."""


def write_sog(path: Path, splats: Splats, options: WriteOptions) -> list[str]:
    """Write a .sog, or a meta.json with textures next to it; returns notes on changed splats."""
    if not textures.fits(len(splats)):
        raise ConfigError(f"{path}: SOG stores 268 million splats at most.")
    meta, pictures, notes = _textures(splats)
    meta |= {"antialias": True, "model": ANTIALIASED} if options.antialiased else {}
    meta |= {} if options.origin is None else {ORIGIN: options.origin.tolist()}
    files = textures.encode_all(pictures)
    if path.suffix.lower() == ".json":
        write_parts(path, files, lambda *found: _index(meta, *found), parts_in, _OF_SH)
        return notes
    packed = io.BytesIO()
    # Stored, not deflated: WebP is compressed already, and some readers support only this.
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_STORED) as archive:
        for name, raw in {META: json.dumps(meta).encode(), **files}.items():
            archive.writestr(zipfile.ZipInfo(name), raw)
    atomic_write(path, packed.getvalue())
    return notes


def parts_in(meta: dict[str, Any]) -> list[str]:
    """Textures listed in a meta.json."""
    sections = (meta[name] for name in SECTIONS if name in meta)
    return [name for section in sections if section for name in section["files"]]


def _index(meta: dict[str, Any], names: dict[str, str], checks: dict[str, int]) -> bytes:
    """Bytes of meta.json, for textures under other names in its folder."""
    for section in SECTIONS:
        if section in meta:
            meta[section]["files"] = [names[name] for name in meta[section]["files"]]
    stated = {names[name]: check for name, check in checks.items()}
    return json.dumps(meta | {"asset": meta["asset"] | {CHECKS: stated}}).encode()


def _textures(splats: Splats) -> tuple[dict[str, Any], dict[str, np.ndarray], list[str]]:
    """Content of meta.json, pictures by name, and notes on changed splats."""
    splats, notes = without_far(splats, _step, _FINE, "SOG")
    for field, most in _LARGEST.items():
        splats, cut = cut_extremes(splats, field, most)
        if cut:
            notes.append(
                f"{count_text(cut, 'splat')} had extreme {field}, which became less extreme: "
                f"SOG has 256 values for those of all splats."
            )
    order = morton_order(splats.means)
    scales, colors = codebook(splats.scales), codebook(splats.sh0)
    low, high, ends = _pack_means(splats.means[order])
    alphas = opacity_bytes(splats.opacities[order])
    pictures = {
        "means_l.webp": _texture(low),
        "means_u.webp": _texture(high),
        "scales.webp": _texture(nearest_entries(scales, splats.scales[order])),
        "quats.webp": _texture(*_pack_quats(splats.quats[order])),
        "sh0.webp": _texture(nearest_entries(colors, splats.sh0[order, 0]), alphas),
    }
    meta: dict[str, Any] = {
        "version": 2,
        "asset": {"generator": f"gscore {__version__}"},
        "count": len(splats),
        "means": {**ends, "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": scales.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": colors.tolist(), "files": ["sh0.webp"]},
    }
    if splats.sh_degree and len(splats):
        rows, labels = palette(splats.shN[order].reshape(len(splats), -1))
        book = codebook(rows)
        meta["shN"] = {
            "count": len(rows),
            "bands": splats.sh_degree,
            "codebook": book.tolist(),
            "files": [*_OF_SH],
        }
        centroids, of_rows = _palette_texture(nearest_entries(book, rows)), _label_texture(labels)
        pictures |= dict(zip(_OF_SH, (centroids, of_rows), strict=True))
    return meta, pictures, notes


def _pack_means(means: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict[str, list[float]]]:
    """Lower and upper bytes [N, 3] of 16-bit steps, and their bounds."""
    logs = _logs(means)
    ends = np.zeros((2, 3))
    if len(means):
        ends = np.stack([logs.min(axis=0), logs.max(axis=0)])
    width = np.where(ends[1] > ends[0], ends[1] - ends[0], 1)
    steps = np.rint((logs - ends[0]) / width * 65535).astype(np.uint16)
    bounds = {"mins": ends[0].tolist(), "maxs": ends[1].tolist()}
    return (steps & 255).astype(np.uint8), (steps >> 8).astype(np.uint8), bounds


def _logs(means: np.ndarray) -> np.ndarray:
    """sign(v) ln(|v| + 1), float64."""
    return np.copysign(np.log1p(np.abs(means.astype(np.float64))), means)


def _step(low: np.ndarray, high: np.ndarray, middle: np.ndarray) -> float:
    """Step of positions in world units, for `without_far`."""
    return float(((_logs(high) - _logs(low)) / 65535 * (np.abs(middle) + 1)).max())


def _pack_quats(quats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Three bytes [N, 3] and a tag [N] per quaternion, as `sog._quats` reads them."""
    largest, three = smallest_three(unit_quats(quats))
    parts = three * np.sqrt(0.5) + 0.5
    return np.rint(np.clip(parts, 0, 1) * 255).astype(np.uint8), (FIRST_TAG + largest).astype(
        np.uint8
    )


def _texture(colors: np.ndarray, alphas: np.ndarray | int = 255) -> np.ndarray:
    """[H, W, 4] uint8 from bytes [N, 3] and alphas [N]."""
    width, height = textures.size_for(len(colors))
    pixels = np.zeros((height * width, 4), np.uint8)
    pixels[:, 3] = 255
    pixels[: len(colors), :3] = colors
    pixels[: len(colors), 3] = alphas
    return pixels.reshape(height, width, 4)


def _palette_texture(indices: np.ndarray) -> np.ndarray:
    """[H, W, 4] uint8 from indices [P, D]: 64 rows per line, one pixel per coefficient."""
    width = indices.shape[1] // 3
    lines = -(-len(indices) // PALETTE_WIDTH)
    pixels = np.full((lines * PALETTE_WIDTH, width, 4), 255, np.uint8)
    pixels[: len(indices), :, :3] = indices.reshape(-1, width, 3)
    return pixels.reshape(lines, PALETTE_WIDTH * width, 4)


def _label_texture(labels: np.ndarray) -> np.ndarray:
    parts = np.zeros((len(labels), 3), np.uint8)
    parts[:, 0], parts[:, 1] = labels & 255, labels >> 8
    return _texture(parts)
