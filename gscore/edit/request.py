"""Edit request: the edits of a model, in the order of their execution."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import ConfigError

_PLACING = ("scale", "rotate", "move")


@dataclass(frozen=True, kw_only=True)
class EditRequest:
    """Steps from the first to the last; what is None or empty is left out.

    Raises:
        ConfigError: values that there cannot be, or that contradict.
    """

    box: Sequence[float] | None = None
    """Keep splats between two corners: x0 y0 z0 x1 y1 z1, world units."""
    sphere: Sequence[float] | None = None
    """Keep splats inside a sphere: x y z radius, world units."""
    frustum: Sequence[int] = ()
    """Keep splats visible in any of these cameras; indices."""
    outside: bool = False
    """Keep the splats outside these shapes instead."""
    min_opacity: float | None = None
    """Least opacity, in [0, 1]."""
    max_size: float | None = None
    """Largest standard deviation, world units."""
    min_contribution: float | None = None
    """Least of `contributions`, px."""
    max_isolation: float | None = None
    """Most of `isolation_of`."""
    min_cluster: int | None = None
    """Least of `cluster_sizes`, splats."""
    gap: float | None = None
    """Of `cluster_sizes`; None: `GAP`."""
    seen_share: float | None = None
    """What adds at least this share of a picture's pixels to a view is neither isolated nor in too
    small a cluster: a few huge splats may be a wall. Needs cameras."""
    sh_degree: int | None = None
    """SH degree at most."""
    count: int | None = None
    """Splats at most, those that matter most."""
    size: float | None = None
    """Megabytes of the file at most."""
    scale: float | None = None
    """Factor about the origin."""
    rotate: Sequence[float] | None = None
    """Degrees about the x, then y, then z axis."""
    move: Sequence[float] | None = None
    """World units."""
    matrix: np.ndarray | None = None
    """[4, 4] float64, new = matrix @ old, instead of these three."""

    def __post_init__(self) -> None:
        if self.box is not None and not all(
            low < high for low, high in zip(self.box[:3], self.box[3:], strict=True)
        ):
            raise ConfigError(
                "A box needs its lower corner first, then its upper one, such as -1 -1 -1 1 1 1, "
                f"got {_words(self.box)}."
            )
        if self.sphere is not None and not self.sphere[3] > 0:
            raise ConfigError(f"The radius of a sphere must be above 0, got {self.sphere[3]:g}.")
        if self.outside and not self.crops:
            raise ConfigError("To keep what lies outside, say of what: a box, sphere or frustum.")
        if self.gap is not None and self.min_cluster is None:
            raise ConfigError("A gap is one between clusters: give the least size of these too.")
        if self.count is not None and self.size is not None:
            raise ConfigError("Give the splats to keep or the megabytes, not both.")
        given = [name for name in _PLACING if getattr(self, name) is not None]
        if self.matrix is not None and given:
            raise ConfigError(f"A matrix says everything: leave out {', '.join(given)}.")

    @property
    def crops(self) -> bool:
        """Whether anything is cut off."""
        return self.box is not None or self.sphere is not None or bool(self.frustum)

    @property
    def moves(self) -> bool:
        """Whether the splats get another place."""
        return self.matrix is not None or any(getattr(self, n) is not None for n in _PLACING)

    def cleaned(self, count: int, *, with_cameras: bool) -> "EditRequest":
        """The same with the usual values of what cleans up `count` splats, where none is given."""
        usual = {name: getattr(USUAL, name) for name in ("min_opacity", "max_isolation")}
        # In models of a few thousand a cluster of few is no dust.
        usual["min_cluster"] = min(USUAL.min_cluster or 0, count // _DUST) or None
        for name in ("min_contribution", "seen_share"):
            usual[name] = getattr(USUAL, name) if with_cameras else None
        missing = {name: v for name, v in usual.items() if getattr(self, name) is None}
        return replace(self, **missing)


def _words(values: Sequence[float]) -> str:
    return " ".join(f"{value:g}" for value in values)


_DUST = 5000
"""A cluster is usual from one part in so many of the splats on."""
GAP = 0.05
"""Between clusters, where none is given."""
USUAL = EditRequest(
    min_opacity=0.005, min_contribution=0.1, max_isolation=8.0, min_cluster=20, seen_share=0.0005
)
"""What cleans up without being seen: see docs/convert.md."""
