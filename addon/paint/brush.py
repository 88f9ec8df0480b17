"""Brush effects on the splats under it; no bpy."""

from dataclasses import dataclass

import numpy as np

from ..core import rgb_to_sh0

COLOR, OPACITY, SELECT = "COLOR", "OPACITY", "SELECT"


@dataclass(frozen=True, kw_only=True)
class Brush:
    """Brush of one stroke."""

    radius: float
    """Radius in pixels of the painted view, or in world units for points in space."""
    does: str = COLOR
    """COLOR, OPACITY or SELECT: the changed attribute; SELECT changes the selection only."""
    strength: float = 1.0
    """Blending weight of the target in the centre of the brush, per stroke, 0 to 1."""
    hardness: float = 0.5
    """Share of the radius with full weight, 0 to 1."""
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Target, sRGB values."""
    opacity: float = 0.0
    """Target, 0 to 1."""
    inverted: bool = False
    """Paint the opacity 1 - `opacity`, or deselect. No effect on colours."""

    def __post_init__(self) -> None:
        if not 0 < self.radius < np.inf:
            raise ValueError(f"The brush radius must be above 0, got {self.radius}.")
        for name in ("strength", "hardness", "opacity"):
            value = getattr(self, name)
            if not 0 <= value <= 1:
                raise ValueError(f"The brush {name} must be between 0 and 1, got {value}.")

    def share(self, distances: np.ndarray) -> np.ndarray:
        """Brush weights [K] in [0, 1] at distances [K] from its centre.

        1 up to the hard part's edge; from there 1 - u^2 (3 - 2 u), u from 0 to 1 at the radius.
        """
        beyond = distances - self.hardness * self.radius
        soft = max((1 - self.hardness) * self.radius, 1e-6 * self.radius)
        u = np.clip(beyond / soft, 0, 1)
        return 1 - u * u * (3 - 2 * u)

    def painted(self, base: np.ndarray, share: np.ndarray) -> np.ndarray:
        """`radiance:base` after a stroke, [K, 4] float32; view-dependent coefficients are kept.

        Args:
            base: [K, 4] float32 before the stroke.
            share: Largest weights of the stroke, [K], as from `share`.
        """
        out = base.copy()
        way = (self.strength * share).astype(np.float32)
        if self.does == COLOR:
            target = rgb_to_sh0(np.array(self.color, np.float64)).astype(np.float32)
            out[:, :3] = (1 - way)[:, None] * base[:, :3] + way[:, None] * target
        elif self.does == OPACITY:
            target = np.float32(1 - self.opacity if self.inverted else self.opacity)
            out[:, 3] = (1 - way) * base[:, 3] + way * target
        return out
