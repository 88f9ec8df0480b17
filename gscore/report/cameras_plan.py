"""Camera plan of the report: cameras coloured by PSNR, and points, from above and from the side."""

import html
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
from .plan import Scale, plan_axes, plan_svg, wedge

_MOST_CAMERAS = 1000
_LEGEND = "PSNR of the measured views; other cameras are drawn hollow"


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
    known = [worth for worth in worths.values() if worth is not None]
    scale = Scale(min(known), max(known), "{:.1f} dB") if known else None

    def wedges(places: np.ndarray, looks: np.ndarray) -> str:
        names = section.scene.cameras.names
        return "".join(
            _wedge(places[i], looks[i], names[i], worths.get(names[i]), scale)
            for i in _drawn(names, worths)
        )

    pictures = "".join(
        f'<figure class="plot"><h3>{name}</h3>{plan_svg(section.scene, axes, name, wedges)}'
        "</figure>"
        for name, axes in (("From above", views[:2]), ("From the side", views[::2]))
    )
    words = f'<p class="hint">{_words(section.found)}</p>' if section.found is not None else ""
    legend = scale.legend(_LEGEND) if scale else ""
    return (
        f'<section id="cameras"><h2>Cameras</h2>{words}{legend}'
        f'<div class="plots two">{pictures}</div></section>\n'
    )


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


def _drawn(names: Sequence[str], worths: Mapping[str, float | None]) -> list[int]:
    """Indices of the drawn cameras: a sample of those without a PSNR, then all with one."""
    others = [i for i, name in enumerate(names) if worths.get(name) is None]
    scored = [i for i, name in enumerate(names) if worths.get(name) is not None]
    return others[:: max(1, -(-len(others) // _MOST_CAMERAS))] + scored


def _wedge(
    at: np.ndarray, look: np.ndarray, name: str, worth: float | None, scale: Scale | None
) -> str:
    """A camera, in the colour of its PSNR."""
    if worth is None or scale is None:
        return wedge(at, look, name)
    return wedge(at, look, f"{name}: {worth:.2f} dB", scale.color(worth))
