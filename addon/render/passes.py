"""Render passes: those that a view layer requests, their registration with Blender, and mattes.

Cryptomatte is that of Psyop's specification 1.2.0: ids are MurmurHash3 of UTF-8 names, kept as
floats that are neither infinite, NaN nor denormal; each pixel lists ids with their coverage.
"""

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass

import bpy
import numpy as np

from ..compat import albedo_pass_name, index_pass_name
from ..splats.objects import has_albedo, is_splats
from .cube import SPLAT_INDEX
from .pass_renderer import HOLDOUT_PASSES
from .scene import Identity
from .splat_values import ALBEDO, NUMBER, SHADOW

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


SWITCHES = {
    *("use_pass_combined", "use_pass_z", "use_pass_object_index"),
    *("use_pass_normal", "use_pass_position", "use_pass_vector"),
    *("use_pass_diffuse_color", "use_pass_shadow"),
    *("use_pass_cryptomatte_object", "use_pass_cryptomatte_asset"),
}
"""Switches of the passes that this engine makes."""
MATTES = (
    *("use_pass_object_index", "pass_alpha_threshold"),
    *("use_pass_cryptomatte_object", "use_pass_cryptomatte_asset", "pass_cryptomatte_depth"),
)
"""Settings of a view layer for mattes."""


@dataclass(frozen=True, kw_only=True)
class RequestedPasses:
    """The passes of a view layer in addition to the picture."""

    depth: bool
    normal: bool
    position: bool
    vector: bool
    albedo: bool
    shadow: bool
    number: bool
    """The index of a splat in its object."""
    holdout_depth: bool
    """Passes with which the compositor cuts meshes at holdout splats."""
    index: bool
    kinds: tuple[str, ...]
    """Kinds of Cryptomatte."""
    levels: int
    """Objects per pixel in Cryptomatte."""
    threshold: float
    """Coverage of a pixel from which on it has an object index."""

    @property
    def mattes(self) -> bool:
        """Whether the passes need the coverage by each object."""
        return self.index or bool(self.kinds)

    @property
    def values(self) -> dict[str, str]:
        """Passes of values of the splats, by the names of `splat_values`."""
        made = {ALBEDO: albedo_pass_name(), SHADOW: "Shadow", NUMBER: SPLAT_INDEX}
        wanted = {ALBEDO: self.albedo, SHADOW: self.shadow, NUMBER: self.number}
        return {name: made[name] for name, on in wanted.items() if on}

    def registered(self) -> list[tuple[str, int, str, str]]:
        """All passes as Blender registers them: name, number of channels, their names, and type."""
        found = [("Combined", 4, "RGBA", "COLOR")]
        if self.depth:
            found.append(("Depth", 1, "Z", "VALUE"))
        for name, on in (("Normal", self.normal), ("Position", self.position)):
            if on:
                found.append((name, 3, "XYZ", "VECTOR"))
        if self.vector:
            found.append(("Vector", 4, "XYZW", "VECTOR"))
        kinds = {NUMBER: (1, "X", "VALUE")}
        found += [
            (made, *kinds.get(name, (3, "RGB", "COLOR"))) for name, made in self.values.items()
        ]
        if self.holdout_depth:
            found += [(name, 1, "Z", "VALUE") for name in HOLDOUT_PASSES]
        if self.index:
            found.append((index_pass_name(), 1, "X", "VALUE"))
        for kind in self.kinds:
            # Lower case, so that lossy files keep these channels exact.
            names = pass_names(kind, self.levels)
            found += [(name, 4, "rgba", "COLOR") for name in names]
        return found

    def mattes_of(
        self, covered: Mapping[Identity, np.ndarray], shape: tuple[int, int], layer: str
    ) -> tuple[dict[str, np.ndarray], dict[str, str]]:
        """The matte passes by name, and the metadata of Cryptomatte for the render's result.

        Args:
            covered: Coverage by object, [H, W] float32.
            shape: H and W.
            layer: Name of the view layer.
        """
        found, stamps = {}, {}
        if self.index:
            found[index_pass_name()] = _index_pass(covered, shape, self.threshold)
        for kind in self.kinds:
            named: dict[str, np.ndarray] = {}  # coverage summed over the objects of one name
            for owner, part in covered.items():
                name = _NAMES[kind](owner)
                named[name] = named[name] + part if name in named else part
            found |= ranked(named, shape, kind, self.levels)
            stamps |= metadata(layer, kind, sorted(named))
        return found, stamps


_NAMES = {
    OBJECT: lambda owner: owner.name,
    ASSET: lambda owner: owner.asset,
}


def splats_of(layer: bpy.types.ViewLayer) -> list[bpy.types.Object]:
    """The rendered splat objects of a view layer, also those in instanced collections."""
    every, found = list(layer.objects), {}
    for ob in every:  # grows meanwhile
        if ob.hide_render or ob in found:
            continue
        found[ob] = None
        if ob.instance_type == "COLLECTION" and ob.instance_collection is not None:
            every += ob.instance_collection.all_objects
    return [ob for ob in found if is_splats(ob)]


def requested_passes(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer, main: bpy.types.Scene | None
) -> RequestedPasses:
    """The passes that a view layer requests.

    Args:
        scene: Its scene.
        layer: The view layer.
        main: The main scene, if this is a splat-only one, whose compositing needs more passes.
    """
    kinds = {
        OBJECT: layer.use_pass_cryptomatte_object,
        ASSET: layer.use_pass_cryptomatte_asset,
    }
    return RequestedPasses(
        depth=layer.use_pass_z,
        normal=layer.use_pass_normal,
        position=layer.use_pass_position,
        vector=layer.use_pass_vector,
        albedo=layer.use_pass_diffuse_color and any(map(has_albedo, splats_of(layer))),
        shadow=layer.use_pass_shadow,
        number=scene.gscore_render.splat_index,
        holdout_depth=layer.use_pass_z and main is not None,
        index=layer.use_pass_object_index,
        kinds=tuple(kind for kind, on in kinds.items() if on),
        levels=layer.pass_cryptomatte_depth,
        threshold=layer.pass_alpha_threshold,
    )


def _index_pass(
    covered: Mapping[Identity, np.ndarray], shape: tuple[int, int], threshold: float
) -> np.ndarray:
    """The Pass Index of the object with the largest coverage of a pixel, [H, W] float32.

    0 where the coverage of all objects together is below the threshold, or zero.
    """
    most, total, result = (np.zeros(shape, np.float32) for _ in range(3))
    for owner, part in covered.items():
        result[part > most] = owner.index
        np.maximum(most, part, out=most)
        total += part
    result[total < threshold] = 0
    return result
