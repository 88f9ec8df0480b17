"""Camera plan of the report: cameras coloured by PSNR, and points, from above and from the side."""

import html
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import GsError
from ..io.files import read_bytes
from ..io.runs import MADE_OF, SEARCH_RECORD
from ..json_text import parse_json
from ..scene import Scene
from ..text_format import count_text
from ..upright import up_of

_SIDE = 420
"""Width and height of a picture in its own units; the page scales it."""
MOST_POINTS = 3000
"""Maximum number of drawn points, evenly sampled."""
_MARGIN = 18.0
_MOST_CAMERAS = 1000
_INNER = (0.02, 0.98)
"""Quantiles of the points within the picture: a few far ones would shrink the rest."""
_SHADES = 6
"""Steps of each colour channel."""
_WORST_TO_BEST = ("#b2182b", "#e8884f", "#a9a9a9", "#5f9fd0", "#1f5fb0")
"""Colours of the measured views' PSNR at equal steps; suitable for colour-blind readers."""


@dataclass(frozen=True, kw_only=True)
class CamerasSection:
    """Contents of the camera section of the report."""

    found: Mapping[str, Any] | None
    """The SfM record, sfm.json; None: the cameras are from another program."""
    scene: Scene
    """Scene of the training."""


def cameras_section(source: Path, scene: Scene) -> CamerasSection:
    """The section of a run.

    Args:
        source: The capture.
        scene: Its cameras and points, in any scale.
    """
    try:
        found = parse_json(read_bytes(source / SEARCH_RECORD))
    except (GsError, ValueError):
        found = None
    return CamerasSection(found=found if isinstance(found, dict) else None, scene=scene)


def made_of(section: CamerasSection) -> str | None:
    """Name of the photo folder or video; None if no record states it."""
    path = section.found.get(MADE_OF) if section.found is not None else None
    if not isinstance(path, str) or not (name := Path(path).name):
        return None
    folder = Path(path).parent.name
    return folder if folder and name in ("images", "input") else name


def cameras_html(section: CamerasSection, worths: Mapping[str, float | None]) -> str:
    """The section: result of SfM, two pictures, and the legend of their colours.

    Args:
        section: Cameras and points.
        worths: PSNR of the measured views by name, dB; None: identical or nothing to measure.
    """
    if not len(section.scene.cameras):
        return ""
    views = plan_axes(section.scene)
    scale = _Scale.of([worth for worth in worths.values() if worth is not None])
    pictures = "".join(
        f'<figure class="plot"><h3>{name}</h3>{_svg(section.scene, axes, name, worths, scale)}'
        "</figure>"
        for name, axes in (("From above", views[:2]), ("From the side", views[::2]))
    )
    words = f'<p class="hint">{_words(section.found)}</p>' if section.found is not None else ""
    return (
        f'<section id="cameras"><h2>Cameras</h2>{words}{scale.legend() if scale else ""}'
        f'<div class="plots two">{pictures}</div></section>\n'
    )


@dataclass(frozen=True)
class _Scale:
    """Colour scale of the measured views."""

    low: float
    high: float

    @classmethod
    def of(cls, worths: Sequence[float]) -> "_Scale | None":
        """Scale from the worst to the best; None if nothing was measured."""
        return cls(min(worths), max(worths)) if worths else None

    def color(self, worth: float) -> str:
        """The nearest colour of a PSNR."""
        share = (worth - self.low) / (self.high - self.low) if self.high > self.low else 1.0
        return _WORST_TO_BEST[round(share * (len(_WORST_TO_BEST) - 1))]

    def legend(self) -> str:
        """Legend with both ends."""
        stops = "".join(f'<i class="step" style="background:{c}"></i>' for c in _WORST_TO_BEST)
        return (
            f'<div class="scale"><span>{self.low:.1f} dB</span><span>{stops}</span>'
            f"<span>{self.high:.1f} dB</span><em>PSNR of the measured views; other cameras are "
            "drawn hollow</em></div>"
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


def _words(found: Mapping[str, Any]) -> str:
    """One line on the SfM result, without fields that the record lacks."""
    parts = []
    count, photos = found.get("registered"), found.get("photos")
    if isinstance(count, int) and isinstance(photos, int):
        parts.append(f"{count} of {count_text(photos, 'photo')} have a camera")
    if isinstance(points := found.get("points"), int):
        parts.append(count_text(points, "point"))
    if isinstance(error := found.get("reprojection_px"), float):
        parts.append(f"mean reprojection error {error:.2f} px")
    alone = found.get("alone")
    if isinstance(alone, list) and alone:
        parts.append(f"without a camera: {', '.join(map(str, alone[:5]))}")
    return html.escape("Found by gscore: " + ", ".join(parts) + ".")


def _svg(
    scene: Scene,
    axes: np.ndarray,
    name: str,
    worths: Mapping[str, float | None],
    scale: _Scale | None,
) -> str:
    """One picture: points in their colours, cameras as wedges that open in viewing direction, the
    measured ones on top."""
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
    zoom = (_SIDE - 2 * _MARGIN) / max(float((high - low).max()), 1e-12)
    middle = (low + high) / 2

    def place(values: np.ndarray) -> np.ndarray:
        return _SIDE / 2 + (values - middle) * zoom * [1, -1]

    kept = place(cloud)
    inside = ((kept > 0) & (kept < _SIDE)).all(axis=1)
    looks = np.asarray(cameras.viewmats, np.float64)[:, 2, :3] @ axes.T
    places, looks = place(centers), looks * [1, -1]
    wedges = "".join(
        _wedge(places[i], looks[i], cameras.names[i], worths.get(cameras.names[i]), scale)
        for i in _drawn(cameras.names, worths)
    )
    label = html.escape(
        f"{name}: {count_text(len(centers), 'camera')}, {count_text(int(usable.sum()), 'point')}"
    )
    return (
        f'<svg class="chart plan" viewBox="0 0 {_SIDE} {_SIDE}" role="img" aria-label="{label}">'
        f"{_dots(kept[inside], colors[inside])}{wedges}</svg>"
    )


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


def _drawn(names: Sequence[str], worths: Mapping[str, float | None]) -> list[int]:
    """Indices of the drawn cameras: a sample of those without a PSNR, then all with one."""
    others = [i for i, name in enumerate(names) if worths.get(name) is None]
    scored = [i for i, name in enumerate(names) if worths.get(name) is not None]
    return others[:: max(1, -(-len(others) // _MOST_CAMERAS))] + scored


def _wedge(
    at: np.ndarray, look: np.ndarray, name: str, worth: float | None, scale: _Scale | None
) -> str:
    """A triangle that opens in the viewing direction, shortened by projection."""
    side = np.array([-look[1], look[0]])
    length = float(np.linalg.norm(look))
    side = side / length if length > 1e-6 else np.array([1.0, 0.0])
    corners = [at, at + 13 * look + 5 * side, at + 13 * look - 5 * side]
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
    words, style = name, ""
    if worth is not None and scale is not None:
        words = f"{name}: {worth:.2f} dB"
        style = f' style="fill:{scale.color(worth)}"'
    kind = "wedge scored" if style else "wedge"
    return (
        f'<polygon points="{path}" class="{kind}"{style}><title>{html.escape(words)}</title>'
        "</polygon>"
    )
