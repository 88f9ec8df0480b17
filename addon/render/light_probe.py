"""Light probe: the light that arrives at a point of the splats from all directions, and the
strongest source in it; no bpy."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..cameras.panorama import EQUIRECTANGULAR, Panorama
from ..srgb import LUMINANCE
from . import picture
from .model import Model
from .pass_renderer import PassRenderer
from .relight import map_directions, map_solid_angles
from .shutter_lens import View

_NEAR = 0.02
"""Automatic near distance, in median distances of the splats."""
_RADIUS = np.radians(20)
"""Radius of the largest source that counts as one light."""
_CONTRAST = 2.0
"""Least brightness of the strongest light, in medians of all directions."""
_SHARE = 0.5
"""Least share of the bright directions that the strongest light has."""
_CLIPPED = 0.97
"""Share of white above which a photo may be overexposed."""
_DISK = np.radians(0.53)
"""Diameter of the sun."""


@dataclass(frozen=True, kw_only=True)
class LightProbe:
    """The light at a point, from all directions."""

    light: np.ndarray
    """[H, W, 3] float32 linear Rec. 709 over black, an equirectangular map of Blender's world: the
    bottom row (straight down) first, +X in the middle, +Y to its left. Not limited to 1."""
    alpha: np.ndarray
    """[H, W] share of each direction that splats cover."""
    distances: np.ndarray
    """[H, W] from the point to the splats in world units, `color.NOTHING` where there are none."""

    @property
    def directions(self) -> np.ndarray:
        """Unit vectors of the pixels [H, W, 3], from the point outwards."""
        return map_directions(*self.alpha.shape)

    @property
    def solid_angles(self) -> np.ndarray:
        """Steradians of the pixels [H, W]."""
        return map_solid_angles(*self.alpha.shape)


@dataclass(frozen=True, kw_only=True)
class Light:
    """The strongest light of a probe."""

    direction: np.ndarray
    """Unit vector towards it [3]."""
    irradiance: np.ndarray
    """Irradiance of a surface that faces it [3], linear Rec. 709."""
    angle: float
    """Angular diameter, radians."""
    distance: float
    """World units from the point of the probe."""
    brightest: float
    """Luminance of its brightest direction, linear."""

    def is_clipped(self, white: float) -> bool:
        """Whether photos in which light of `white` is white may have been overexposed there, so
        that it is stronger than this."""
        return self.brightest >= _CLIPPED * white


def probe(
    model: Model,
    place: np.ndarray,
    *,
    width: int,
    near: float = 0.0,
    options: picture.Options,
    stop: Callable[[], bool] = lambda: False,
) -> LightProbe:
    """Draw the splats around a point.

    Args:
        model: The splats.
        place: World position [3].
        width: Pixels; the map is half as high.
        near: Distance from which splats are drawn, world units; 0: a fiftieth of their median
            distance.
        options: Antialiasing and device.
        stop: True cancels.

    Raises:
        As `picture.draw`.
    """
    if not near:
        means = model.splats.means @ model.matrix[:3, :3].T + model.matrix[:3, 3]
        near = max(float(np.median(np.linalg.norm(means - place, axis=1))) * _NEAR, 1e-6)
    turned = np.eye(4)
    turned[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]  # ahead +X, right -Y, down -Z
    turned[:3, 3] = -turned[:3, :3] @ place
    camera = Panorama(
        viewmat=turned,
        width=width,
        height=width // 2,
        near=near,
        kind=EQUIRECTANGULAR,
        settings=(-np.pi / 2, np.pi / 2, -np.pi, np.pi),
    )
    renderer = PassRenderer(
        options=replace(options, background=(0.0, 0.0, 0.0), depths=True, window=None),
        transparent=True,
        to_scene=np.eye(3),
    )
    passes = renderer.render(View(model=model, camera=camera), stop)
    made = passes["Combined"]
    return LightProbe(light=made[..., :3], alpha=made[..., 3], distances=passes["Depth"])


def sky_irradiance(found: LightProbe) -> np.ndarray:
    """Irradiance [3] of an upward surface, linear Rec. 709."""
    weights = np.maximum(found.directions[..., 2], 0) * found.solid_angles
    return np.einsum("hwc,hw->c", found.light.astype(np.float64), weights)


def strongest_light(found: LightProbe) -> Light | None:
    """The strongest light of a probe; None: the light comes from all sides.

    Bright are directions above the middle between the median and the brightest one, after a mean
    over 3 x 3 pixels. They are one light if half of them are within 20 degrees of their mean.
    """
    shown = found.alpha > 0.5
    if not shown.any():
        return None
    brightness = np.where(shown, found.light @ LUMINANCE, 0.0)
    smooth = _smoothed(brightness)
    median = float(np.median(smooth[shown]))
    peak = float(smooth.max())
    if peak <= 0 or peak < _CONTRAST * median:
        return None
    directions, weights = found.directions, found.solid_angles
    bright = smooth >= (peak + median) / 2
    direction = directions[np.unravel_index(np.argmax(smooth), smooth.shape)]
    for _ in range(4):
        near = bright & (directions @ direction > np.cos(_RADIUS))
        mean = (directions[near] * (brightness * weights)[near][:, None]).sum(0)
        direction = mean / np.linalg.norm(mean)
    if weights[near].sum() < _SHARE * weights[bright].sum():
        return None
    away = np.arccos(np.clip(directions[near] @ direction, -1, 1))
    spread = np.sqrt((away**2 * weights[near]).sum() / weights[near].sum())
    light = found.light.astype(np.float64)
    return Light(
        direction=direction,
        irradiance=(light[near] * weights[near][:, None]).sum(0),
        # A uniform disk has a root mean square distance of its radius times sqrt(1/2).
        angle=max(2 * np.sqrt(2) * float(spread), _DISK),
        distance=float(np.median(found.distances[near])),
        brightest=float(brightness[near].max()),
    )


def _smoothed(values: np.ndarray) -> np.ndarray:
    """Means over 3 x 3 pixels [H, W]; columns are cyclic."""
    rows = np.pad(values, ((1, 1), (0, 0)), mode="edge")
    rows = (rows[:-2] + rows[1:-1] + rows[2:]) / 3
    return (np.roll(rows, 1, 1) + rows + np.roll(rows, -1, 1)) / 3
