"""Plan of a scene: its points and cameras projected along an axis, with marks in colours of a
scale, as SVG."""

import html
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..scene import Scene
from ..text_format import count_text
from ..upright import up_of

SIDE = 420
"""Width and height of a picture in its own units; the page scales it."""
MOST_POINTS = 3000
"""Maximum number of drawn points, evenly sampled."""
_MARGIN = 18.0
_INNER = (0.02, 0.98)
"""Quantiles of the points within the picture: a few far ones would shrink the rest."""
_SHADES = 6
"""Steps of each colour channel."""
_WORST_TO_BEST = ("#b2182b", "#e8884f", "#a9a9a9", "#5f9fd0", "#1f5fb0")
"""Colours at equal steps; suitable for colour-blind readers."""


@dataclass(frozen=True)
class Scale:
    """Colour scale from the worst to the best value."""

    low: float
    high: float
    form: str
    """Format of a value in the legend."""

    def color(self, value: float) -> str:
        """The nearest colour of a value."""
        share = (value - self.low) / (self.high - self.low) if self.high > self.low else 1.0
        return _WORST_TO_BEST[round(share * (len(_WORST_TO_BEST) - 1))]

    def legend(self, text: str) -> str:
        """Legend with both ends and a text, HTML."""
        stops = "".join(f'<i class="step" style="background:{c}"></i>' for c in _WORST_TO_BEST)
        return (
            f'<div class="scale"><span>{self.form.format(self.low)}</span><span>{stops}</span>'
            f"<span>{self.form.format(self.high)}</span><em>{text}</em></div>"
        )


def plan_axes(scene: Scene) -> np.ndarray:
    """[3, 3] float64, unit rows: right, away and up in a plan of the scene.

    Up is as in `up_of`; right is the direction of the largest spread of the cameras.
    """
    centers = np.asarray(scene.cameras.centers, np.float64)
    spread = np.linalg.svd(centers - centers.mean(axis=0), full_matrices=True)[2]
    up = up_of(scene.cameras)
    # The most horizontal of the directions of spread, never up itself.
    level = spread - np.outer(spread @ up, up)
    lengths = np.linalg.norm(level, axis=1)
    right = level[0] / lengths[0] if lengths[0] > 0.3 else level[1] / lengths[1]
    return np.stack([right, np.cross(up, right), up])


Marks = Callable[[np.ndarray, np.ndarray], str]
"""SVG of marks from the places of all cameras in the picture, [C, 2], and the projections of their
viewing directions, [C, 2], at most 1 long."""


def plan_svg(scene: Scene, axes: np.ndarray, name: str, marks: Marks) -> str:
    """A picture: points in their colours, and marks on top.

    Args:
        scene: Cameras and points.
        axes: [2, 3], directions to the right and upwards.
        name: Of the picture.
        marks: What is drawn on top.
    """
    cameras, points = scene.cameras, scene.points
    usable = np.isfinite(points.points).all(axis=1)
    every = max(1, -(-int(usable.sum()) // MOST_POINTS))
    cloud = points.points[usable][::every].astype(np.float64) @ axes.T
    colors = points.colors[usable][::every]
    centers = np.asarray(cameras.centers, np.float64) @ axes.T
    low, high = centers.min(axis=0), centers.max(axis=0)
    if len(cloud):
        inner = np.quantile(cloud, _INNER, axis=0)
        low, high = np.minimum(low, inner[0]), np.maximum(high, inner[1])
    zoom = (SIDE - 2 * _MARGIN) / max(float((high - low).max()), 1e-12)
    middle = (low + high) / 2

    def place(values: np.ndarray) -> np.ndarray:
        return SIDE / 2 + (values - middle) * zoom * [1, -1]

    kept = place(cloud)
    inside = ((kept > 0) & (kept < SIDE)).all(axis=1)
    looks = np.asarray(cameras.viewmats, np.float64)[:, 2, :3] @ axes.T * [1, -1]
    label = html.escape(
        f"{name}: {count_text(len(centers), 'camera')}, {count_text(int(usable.sum()), 'point')}"
    )
    return (
        f'<svg class="chart plan" viewBox="0 0 {SIDE} {SIDE}" role="img" aria-label="{label}">'
        f"{_dots(kept[inside], colors[inside])}{marks(place(centers), looks)}</svg>"
    )


def wedge(at: np.ndarray, look: np.ndarray, title: str, color: str = "") -> str:
    """A camera: a triangle that opens in the viewing direction, shortened by projection.

    Args:
        at: [2], its place.
        look: [2], its projected viewing direction.
        title: Shown when the mouse is over it.
        color: Fill; empty: hollow.
    """
    side = np.array([-look[1], look[0]])
    length = float(np.linalg.norm(look))
    side = side / length if length > 1e-6 else np.array([1.0, 0.0])
    corners = [at, at + 13 * look + 5 * side, at + 13 * look - 5 * side]
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
    kind = f'"wedge scored" style="fill:{color}"' if color else '"wedge"'
    return f'<polygon points="{path}" class={kind}><title>{html.escape(title)}</title></polygon>'


def _dots(places: np.ndarray, colors: np.ndarray) -> str:
    """Points as one path per shade."""
    step = 256 // _SHADES
    shades = np.minimum(np.asarray(colors, np.int64) // step * step + step // 2, 255)
    groups: dict[tuple[int, ...], list[str]] = defaultdict(list)
    for (x, y), shade in zip(places.tolist(), shades.tolist(), strict=True):
        groups[tuple(shade)].append(f"M{x:.1f} {y:.1f}h0")
    return "".join(
        f'<path class="dots" stroke="rgb({r},{g},{b})" d="{"".join(marks)}"/>'
        for (r, g, b), marks in sorted(groups.items())
    )
