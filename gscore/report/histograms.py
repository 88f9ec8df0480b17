"""Histograms of splats in the report: opacity, size and length."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..splats import Splats
from ..text_format import count_text
from .curves import BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH, axes, chart_svg, log_ticks, nice_ticks
from .curves import short_number as short

_BINS = 48
_INNER = (0.001, 0.999)
"""Quantiles at the ends of the bins; values beyond count in the first and last bin."""
_EXPONENT = 300.0
"""Limit of log scales, so that exponentials and their quotients fit float64."""


@dataclass(frozen=True, kw_only=True)
class Histogram:
    """Histogram of a quantity."""

    name: str
    unit: str
    """Text under the axis."""
    edges: np.ndarray
    """[B + 1] float64, increasing."""
    counts: np.ndarray
    """[B] int64, splats."""
    median: float
    log: bool
    """Bins have equal widths in the logarithm."""


def splat_histograms(parts: Iterable[Splats]) -> tuple[Histogram, ...]:
    """Opacity, size and anisotropy of a model given in parts; empty for an empty model."""
    found: tuple[list[np.ndarray], ...] = ([], [], [])
    for splats in parts:
        logs = np.clip(splats.scales.astype(np.float64), -_EXPONENT, _EXPONENT)
        largest, smallest = logs.max(axis=1), logs.min(axis=1)
        found[0].append(0.5 * (1 + np.tanh(0.5 * splats.opacities.astype(np.float64))))
        found[1].append(np.exp(largest))
        found[2].append(np.exp(largest - smallest))
    opacity, size, anisotropy = (np.concatenate(each or [np.zeros(0)]) for each in found)
    if not len(opacity):
        return ()
    even, sizes, ratios = np.linspace(0, 1, _BINS + 1), _log_edges(size), _log_edges(anisotropy, 1)
    return (
        _histogram("Opacity", "", opacity, even, log=False),
        _histogram("Size", "world units", size, sizes, log=True),
        _histogram("Anisotropy", "longest / shortest axis", anisotropy, ratios, log=True),
    )


def histograms_html(histograms: Iterable[Histogram]) -> str:
    """The section; empty without histograms."""
    plots = "".join(
        f'<figure class="plot"><h3>{h.name}{" <small>log scale</small>" if h.log else ""}</h3>'
        f'{_svg(h)}<p class="bars-note">median {short(h.median)}</p></figure>'
        for h in histograms
    )
    if not plots:
        return ""
    return (
        '<section id="splats"><h2>Splats</h2><p class="hint">Size: the largest standard deviation '
        f'of a splat.</p><div class="plots">{plots}</div></section>\n'
    )


def _log_edges(values: np.ndarray, least: float = 0.0) -> np.ndarray:
    low, high = np.quantile(values, _INNER)
    low = least or low
    if not high > low * 1.01:  # all equal
        low, high = low / 2, high * 2
    return np.geomspace(low, high, _BINS + 1)


def _histogram(
    name: str, unit: str, values: np.ndarray, edges: np.ndarray, *, log: bool
) -> Histogram:
    # `np.histogram` would not count values beyond the ends.
    place = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    return Histogram(
        name=name,
        unit=unit,
        edges=edges,
        counts=np.bincount(place, minlength=len(edges) - 1),
        median=float(np.median(values)),
        log=log,
    )


def _svg(histogram: Histogram) -> str:
    h = histogram
    low, high = float(h.edges[0]), float(h.edges[-1])
    top = max(int(h.counts.max()), 1) * 1.06

    def to_x(value: float) -> float:
        share = (value - low) / (high - low)
        if h.log:
            share = float(np.log(value / low) / np.log(high / low))
        return LEFT + share * (WIDTH - LEFT - RIGHT)

    def to_y(count: float) -> float:
        return HEIGHT - BOTTOM - count / top * (HEIGHT - TOP - BOTTOM)

    x_ticks = nice_ticks(low, high)
    if h.log:
        ticks = log_ticks(low, high)
        x_ticks = [t for t in ticks if len(ticks) < 8 or f"{t:e}"[0] == "1"] or x_ticks
    base, bars, hover = to_y(0), [], []
    for left, right, count in zip(h.edges[:-1], h.edges[1:], h.counts.tolist(), strict=True):
        x0, x1, y = to_x(float(left)), to_x(float(right)), to_y(count)
        bars.append(f"M{x0:.1f} {base:.1f}V{y:.1f}H{x1 - 0.8:.1f}V{base:.1f}Z")
        words = f"{count_text(count, 'splat')}: {short(float(left))} to {short(float(right))}"
        hover.append((round((x0 + x1) / 2, 1), round(y, 1), words))
    parts = axes(x_ticks, nice_ticks(0, top), to_x, to_y, h.unit)
    return chart_svg(h.name, f'{parts}<path class="bars" d="{"".join(bars)}"/>', hover)
