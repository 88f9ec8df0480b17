"""Render passes: those that a view layer requests, and their registration with Blender."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ..compat import index_pass_name
from . import cryptomatte, holdout_passes
from .compositing_scene import main_scene
from .coverage import index_pass, summed
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
            found += [(name, 1, "Z", "VALUE") for name in holdout_passes.NAMES]
        if self.index:
            found.append((index_pass_name(), 1, "X", "VALUE"))
        for kind in self.kinds:
            # Lower case, so that lossy files keep these channels exact.
            names = cryptomatte.pass_names(kind, self.levels)
            found += [(name, 4, "rgba", "COLOR") for name in names]
        return found

    def mattes_of(
        self, covered: Mapping[Identity, np.ndarray], shape: tuple[int, int]
    ) -> dict[str, np.ndarray]:
        """The matte passes by name.

        Args:
            covered: Coverage by object, [H, W] float32.
            shape: H and W.
        """
        found = {}
        if self.index:
            found[index_pass_name()] = index_pass(covered, shape, self.threshold)
        for kind in self.kinds:
            named = summed(covered, _NAMES[kind])
            found |= cryptomatte.ranked(named, shape, kind, self.levels)
        return found

    def stamp(self, result: Any, layer: str, covered: Mapping[Identity, np.ndarray]) -> None:
        """Write the metadata of Cryptomatte into a render's result.

        Args:
            result: The RenderResult of the whole render.
            layer: Name of the view layer.
            covered: As for `mattes_of`.
        """
        for kind in self.kinds:
            names = sorted({_NAMES[kind](owner) for owner in covered})
            for key, value in cryptomatte.metadata(layer, kind, names).items():
                result.stamp_data_add_field(key, value)


_NAMES = {
    cryptomatte.OBJECT: lambda owner: owner.name,
    cryptomatte.ASSET: lambda owner: owner.asset,
}


def requested_passes(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> RequestedPasses:
    """The passes that a view layer requests, with those that compositing needs in a splat-only
    scene."""
    kinds = {
        cryptomatte.OBJECT: layer.use_pass_cryptomatte_object,
        cryptomatte.ASSET: layer.use_pass_cryptomatte_asset,
    }
    return RequestedPasses(
        depth=layer.use_pass_z,
        holdout_depth=layer.use_pass_z and main_scene(scene) is not None,
        index=layer.use_pass_object_index,
        kinds=tuple(kind for kind, on in kinds.items() if on),
        levels=layer.pass_cryptomatte_depth,
        threshold=layer.pass_alpha_threshold,
    )
