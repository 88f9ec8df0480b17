"""Cryptomatte passes: object mattes by hashed names, as in Psyop's specification 1.2.0.

Ids are MurmurHash3 of UTF-8 names, kept as floats that are neither infinite, NaN nor denormal;
each pixel lists ids with their coverage; no bpy.
"""

import json
import struct
from collections.abc import Mapping

import numpy as np

_WORD = 0xFFFFFFFF
_ROWS = 64
"""Rows of a picture that are sorted together, few enough for the processor's cache."""
OBJECT, ASSET = "CryptoObject", "CryptoAsset"
"""Kinds of mattes: by object, or by the uppermost parent."""


def name_hash(name: str) -> int:
    """MurmurHash3_x86_32 of a name, seed 0."""
    data, result = name.encode(), 0
    whole = len(data) // 4 * 4
    for i in range(0, whole, 4):
        result = _rotated(result ^ _scrambled(data[i : i + 4]), 13)
        result = (result * 5 + 0xE6546B64) & _WORD
    result ^= _scrambled(data[whole:]) ^ len(data)
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35)):
        result = ((result ^ (result >> shift)) * factor) & _WORD
    return result ^ (result >> 16)


def _scrambled(piece: bytes) -> int:
    word = int.from_bytes(piece, "little") * 0xCC9E2D51 & _WORD
    return _rotated(word, 15) * 0x1B873593 & _WORD


def _rotated(word: int, bits: int) -> int:
    return (word << bits | word >> (32 - bits)) & _WORD


def id_of(name: str) -> np.float32:
    """A name's id in pixels: the hash's bits as a float with a clamped, normal exponent."""
    bits = name_hash(name)
    exponent = min(max(bits >> 23 & 0xFF, 1), 254)
    (value,) = struct.unpack("<f", struct.pack("<I", bits & 0x807FFFFF | exponent << 23))
    return np.float32(value)


def pass_names(kind: str, levels: int) -> list[str]:
    """Names of the passes that store `levels` ids per pixel, two each."""
    return [f"{kind}{i:02}" for i in range((levels + 1) // 2)]


def ranked(
    covered: Mapping[str, np.ndarray], shape: tuple[int, int], kind: str, levels: int
) -> dict[str, np.ndarray]:
    """The passes of a kind, with ids sorted by coverage, largest first.

    Args:
        covered: Coverage by name, [H, W] float32.
        shape: H and W, for an empty `covered`.
        kind: OBJECT or ASSET.
        levels: Ids per pixel; those of least coverage are left out.

    Returns:
        [H, W, 4] float32 by pass: id, coverage, id, coverage; padded with zeros.
    """
    names = pass_names(kind, levels)
    passes = np.zeros((len(names), *shape, 4), np.float32)
    ids = np.array([id_of(name) for name in covered], np.float32)
    for first in range(0, shape[0] if covered else 0, _ROWS):
        band = slice(first, first + _ROWS)
        shares = np.stack([part[band] for part in covered.values()], -1)
        order = np.argsort(-shares, axis=-1, kind="stable")[..., : 2 * len(names)]
        shares = np.take_along_axis(shares, order, -1)
        found = np.stack([np.where(shares > 0, ids[order], 0), shares], -1)
        for rank in range(order.shape[-1]):
            half = 2 * (rank % 2)
            passes[rank // 2, band, :, half : half + 2] = found[..., rank, :]
    return dict(zip(names, passes, strict=True))


def metadata(layer: str, kind: str, names: list[str]) -> dict[str, str]:
    """Metadata of the passes of a kind, by the keys of Blender and EXR files.

    Args:
        layer: Name of the view layer.
        kind: OBJECT or ASSET.
        names: All names that may occur in the picture.
    """
    called = f"{layer}.{kind}"
    manifest = {name: f"{name_hash(name):08x}" for name in names}
    fields = {
        "name": called,
        "hash": "MurmurHash3_32",
        "conversion": "uint32_to_float32",
        "manifest": json.dumps(manifest, ensure_ascii=False, separators=(",", ":")),
    }
    # Seven digits of the hash, as in the specification's example.
    return {f"cryptomatte/{name_hash(called):08x}"[:19] + f"/{k}": v for k, v in fields.items()}
