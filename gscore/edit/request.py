"""Edit request: the edits of a model, in the order of their execution."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import ConfigError

_TRANSFORMS = ("scale", "rotate", "move")


@dataclass(frozen=True, kw_only=True)
class EditRequest:
    """Steps in order; those that are None or empty are skipped.

    Raises:
        ConfigError: values are invalid or contradict each other.
    """

    box: Sequence[float] | None = None
    """Keep splats between two corners: x0 y0 z0 x1 y1 z1, world units."""
    sphere: Sequence[float] | None = None
    """Keep splats inside a sphere: x y z radius, world units."""
    frustum: Sequence[int] = ()
    """Keep splats in the picture of any of these cameras; indices."""
    outside: bool = False
    """Keep the splats outside these shapes instead."""
    heal: Sequence[float] | None = None
    """Fill the hole inside a sphere: x y z radius, world units; see `heal`."""
    min_opacity: float | None = None
    """Least opacity, in [0, 1]."""
    max_size: float | None = None
    """Largest standard deviation, world units."""
    min_contribution: float | None = None
    """Least value of `contributions`, px."""
    max_isolation: float | None = None
    """Largest value of `isolation_of`."""
    min_cluster: int | None = None
    """Least value of `cluster_sizes`, splats."""
    gap: float | None = None
    """`gap` of `cluster_sizes`; None: `GAP`."""
    seen_share: float | None = None
    """Splats that contribute at least this share of a picture's pixels to a view are exempt from
    isolation and clusters, because a few huge splats may be a wall. Needs cameras."""
    sh_degree: int | None = None
    """Highest SH degree."""
    count: int | None = None
    """Most splats, the most important ones."""
    size: float | None = None
    """Largest file size, MB."""
    scale: float | None = None
    """Scale factor about the origin."""
    rotate: Sequence[float] | None = None
    """Rotation about the x, then y, then z axis, degrees."""
    move: Sequence[float] | None = None
    """Translation, world units."""
    matrix: np.ndarray | None = None
    """[4, 4] float64, new = matrix @ old, instead of these three."""

    def __post_init__(self) -> None:
        if self.box is not None and not all(
            low < high for low, high in zip(self.box[:3], self.box[3:], strict=True)
        ):
            raise ConfigError(
                "A box needs its lower corner first, then its upper one, such as -1 -1 -1 1 1 1, "
                f"got {' '.join(f'{value:g}' for value in self.box)}."
            )
        if self.sphere is not None and not self.sphere[3] > 0:
            raise ConfigError(f"The radius of a sphere must be above 0, got {self.sphere[3]:g}.")
        if self.heal is not None and not self.heal[3] > 0:
            raise ConfigError(f"The radius of a hole must be above 0, got {self.heal[3]:g}.")
        if not self.outside and self._keeps_only_the_hole:
            raise ConfigError(
                "The crop keeps only splats in the hole that is to be healed: add `--outside` to "
                "remove them instead."
            )
        if self.outside and not self.crops:
            raise ConfigError("Outside needs a shape: give a box, sphere or frustum.")
        if self.gap is not None and self.min_cluster is None:
            raise ConfigError("A gap is one between clusters: give their least size too.")
        if self.count is not None and self.size is not None:
            raise ConfigError("Give the splats to keep or the megabytes, not both.")
        given = [name for name in _TRANSFORMS if getattr(self, name) is not None]
        if self.matrix is not None and given:
            raise ConfigError(f"A matrix is complete: leave out {', '.join(given)}.")

    @property
    def crops(self) -> bool:
        """True if there is a crop."""
        return self.box is not None or self.sphere is not None or bool(self.frustum)

    @property
    def _keeps_only_the_hole(self) -> bool:
        """True if the sphere to heal contains the box or the sphere of the crop."""
        if self.heal is None:
            return False
        *middle, radius = self.heal
        reaches = []
        if self.sphere is not None:
            reaches.append(math.dist(middle, self.sphere[:3]) + self.sphere[3])
        if self.box is not None:
            sides = zip(middle, self.box[:3], self.box[3:], strict=True)
            reaches.append(math.hypot(*(max(m - low, high - m) for m, low, high in sides)))
        return any(reach <= radius for reach in reaches)

    @property
    def moves(self) -> bool:
        """True if the splats are transformed."""
        return self.matrix is not None or any(getattr(self, n) is not None for n in _TRANSFORMS)

    def cleaned(self, count: int, *, with_cameras: bool) -> "EditRequest":
        """The request with default values for cleaning `count` splats, where none is given."""
        usual = {name: getattr(USUAL, name) for name in ("min_opacity", "max_isolation")}
        # Small clusters are not dust in models of a few thousand splats.
        usual["min_cluster"] = min(USUAL.min_cluster or 0, count // _DUST) or None
        for name in ("min_contribution", "seen_share"):
            usual[name] = getattr(USUAL, name) if with_cameras else None
        missing = {name: v for name, v in usual.items() if getattr(self, name) is None}
        return replace(self, **missing)


_DUST = 5000
"""The default least cluster is at most the number of splats divided by this."""
GAP = 0.05
"""Default gap between clusters."""
USUAL = EditRequest(
    min_opacity=0.005, min_contribution=0.1, max_isolation=8.0, min_cluster=20, seen_share=0.0005
)
"""Default values that clean without visible changes: see docs/convert.md."""
