"""Render passes: those that a view layer requests, and their registration with Blender."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import bpy
import numpy as np

from ..compat import index_pass_name
from . import cryptomatte
from .pass_renderer import HOLDOUT_PASSES
from .scene import Identity

SWITCHES = {
    *("use_pass_combined", "use_pass_z", "use_pass_object_index"),
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

    def registered(self) -> list[tuple[str, int, str, str]]:
        """All passes as Blender registers them: name, number of channels, their names, and type."""
        found = [("Combined", 4, "RGBA", "COLOR")]
        if self.depth:
            found.append(("Depth", 1, "Z", "VALUE"))
        if self.holdout_depth:
            found += [(name, 1, "Z", "VALUE") for name in HOLDOUT_PASSES]
        if self.index:
            found.append((index_pass_name(), 1, "X", "VALUE"))
        for kind in self.kinds:
            # Lower case, so that lossy files keep these channels exact.
            names = cryptomatte.pass_names(kind, self.levels)
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
            named = _summed(covered, _NAMES[kind])
            found |= cryptomatte.ranked(named, shape, kind, self.levels)
            stamps |= cryptomatte.metadata(layer, kind, sorted(named))
        return found, stamps


_NAMES = {
    cryptomatte.OBJECT: lambda owner: owner.name,
    cryptomatte.ASSET: lambda owner: owner.asset,
}


def requested_passes(layer: bpy.types.ViewLayer, main: bpy.types.Scene | None) -> RequestedPasses:
    """The passes that a view layer requests.

    Args:
        layer: The view layer.
        main: The main scene, if this is a splat-only one, whose compositing needs more passes.
    """
    kinds = {
        cryptomatte.OBJECT: layer.use_pass_cryptomatte_object,
        cryptomatte.ASSET: layer.use_pass_cryptomatte_asset,
    }
    return RequestedPasses(
        depth=layer.use_pass_z,
        holdout_depth=layer.use_pass_z and main is not None,
        index=layer.use_pass_object_index,
        kinds=tuple(kind for kind, on in kinds.items() if on),
        levels=layer.pass_cryptomatte_depth,
        threshold=layer.pass_alpha_threshold,
    )


def _summed(
    covered: Mapping[Identity, np.ndarray], name_of: Callable[[Identity], str]
) -> dict[str, np.ndarray]:
    """Coverage summed over the objects of one name, by name."""
    total: dict[str, np.ndarray] = {}
    for owner, part in covered.items():
        name = name_of(owner)
        total[name] = total[name] + part if name in total else part
    return total


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
