"""Trust map of the report: how far photos confirm the views between them, from above."""

import html
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..quoting import brief
from ..scene import Scene
from ..text_format import LOW_TRUST, trust_text
from .plan import Scale, plan_axes, plan_svg, wedge

_NAMED = 3
"""Most places in the sentence."""
_MOST_CAMERAS = 1000
_LEGEND = "trust in the view halfway between two photos"


def trust_html(scene: Scene, metrics: Mapping[str, Any]) -> str:
    """The section: trust, the lowest places with advice, and a map; empty: not
    measured, or the cameras are not those of the scene.

    Args:
        scene: Cameras and points.
        metrics: Content of metrics.json.
    """
    index = {name: i for i, name in enumerate(scene.cameras.names)}
    found = [
        each for each in metrics.get("trust") or () if all(n in index for n in each["between"])
    ]
    if not found:
        return ""
    found.sort(key=lambda each: -each["trust"])  # the lowest are drawn last, on top
    scale = Scale(0.0, found[0]["trust"] or 1.0, "{:.0%}")

    def marks(places: np.ndarray, looks: np.ndarray) -> str:
        step = max(1, -(-len(places) // _MOST_CAMERAS))
        names = scene.cameras.names
        cameras = "".join(wedge(places[i], looks[i], names[i]) for i in range(0, len(places), step))
        ends = [(places[index[a]], places[index[b]]) for a, b in (e["between"] for e in found)]
        return cameras + "".join(map(_segment, ends, found, [scale] * len(found)))

    picture = plan_svg(scene, plan_axes(scene)[:2], "Trust from above", marks)
    return (
        '<section id="trust"><h2>Views between the photos</h2>'
        f'<p class="hint">{html.escape(_sentences(found, metrics))}</p>{scale.legend(_LEGEND)}'
        f'<div class="plots two"><figure class="plot"><h3>From above</h3>{picture}</figure></div>'
        "</section>\n"
    )


def _segment(ends: tuple[np.ndarray, np.ndarray], found: Mapping[str, Any], scale: Scale) -> str:
    """The line between two photos, in the colour of its trust."""
    (x1, y1), (x2, y2) = ends
    a, b = found["between"]
    title = html.escape(f"between {a} and {b}: {found['trust']:.0%}")
    return (
        f'<line class="trust" x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" '
        f'style="stroke:{scale.color(found["trust"])}"><title>{title}</title></line>'
    )


def _sentences(found: Sequence[Mapping[str, Any]], metrics: Mapping[str, Any]) -> str:
    """Definition of trust, its figures, and the lowest places.

    Args:
        found: The views, highest trust first.
        metrics: Content of metrics.json.
    """
    text = (
        "Trust is the share of a view halfway between two photos that the eight nearest photos "
        "show in the same colours. Veils and places that no photo shows lower it. "
        f"{trust_text(metrics)}"
    )
    low = [each for each in found[::-1] if each["trust"] < LOW_TRUST * metrics["trust_median"]]
    if not low:
        return text
    places = "; ".join(
        f"{brief(a)} and {brief(b)} ({each['trust']:.0%})"
        for each in low[:_NAMED]
        for a, b in [each["between"]]
    )
    more = f" and {len(low) - _NAMED} more" if len(low) > _NAMED else ""
    return (
        f"{text} Below half of the median: between {places}{more}: take more photos there, or "
        "keep cameras of new pictures away from these places."
    )
