"""Curves of a run as inline SVG, without external resources."""

import html
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

WIDTH, HEIGHT = 430, 230
"""Size of a chart in its own units; the page scales it."""
LEFT, RIGHT, TOP, BOTTOM = 46, 18, 14, 36
"""Margins around the plot, for the numbers at the axes."""
_LETTER = 6.5
"""Width of a letter of the labels above a chart, with some margin."""
_BUCKETS = 240
_Scale = Callable[[float], float]
_Point = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Series:
    """One curve: many noisy points drawn as a line with a band, or few exact ones as dots."""

    label: str
    """Name in the legend."""
    points: Sequence[tuple[float, float]]
    """(x, y), finite, x ascending."""
    dots: bool = False
    """Draw a dot at every point, for measurements without noise."""


@dataclass(frozen=True, kw_only=True)
class Mark:
    """An event at a value of the x axis."""

    x: float
    label: str


def clean_points(pairs: Sequence[tuple[float | None, float | None]]) -> list[tuple[float, float]]:
    """The pairs of finite numbers, sorted by x."""
    kept = [
        (float(x), float(y))
        for x, y in pairs
        if x is not None and y is not None and math.isfinite(x) and math.isfinite(y)
    ]
    return sorted(kept, key=lambda p: p[0])


def nice_ticks(low: float, high: float, count: int = 5) -> list[float]:
    """About `count` round numbers (1, 2 or 5 times a power of ten apart) within [low, high]."""
    if not high > low:
        return [low]
    raw = (high - low) / count
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1, 2, 5, 10) if m * power >= raw * 0.999)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [k * step for k in range(first, last + 1)]


def log_ticks(low: float, high: float) -> list[float]:
    """1, 2 and 5 times powers of ten within [low, high], both positive."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ticks = [m * 10.0**p for p in powers for m in (1, 2, 5)]
    return [t for t in ticks if low * 0.999 <= t <= high * 1.001]


def short_number(value: float) -> str:
    """A number as short text: 1.2 M, 34 k, 0.05, 27.3."""
    size = abs(value)
    if size >= 1e6:
        return f"{value / 1e6:.3g} M"
    if size >= 1e4:
        return f"{value / 1e3:.3g} k"
    return f"{value:.4g}" if size >= 1000 else f"{value:.3g}"


def line_chart(
    series: Sequence[Series],
    *,
    label: str,
    x_unit: str,
    log: bool = False,
    from_zero: bool = False,
    marks: Sequence[Mark] = (),
) -> str:
    """One chart as an `<svg>` element; a sentence instead if there are too few points.

    Args:
        series: Curves over a common x axis.
        label: Description of the chart, for screen readers.
        x_unit: Unit under the x axis.
        log: Logarithmic y axis; points that are not positive are left out.
        from_zero: The y axis starts at 0.
        marks: Vertical lines, drawn if within the range of the curves.
    """
    drawn = [(s, [p for p in s.points if p[1] > 0] if log else list(s.points)) for s in series]
    every = [p for _, points in drawn for p in points]
    if len({x for x, _ in every}) < 2:
        return '<p class="empty">Not enough points to draw a curve.</p>'
    x_low, x_high = min(x for x, _ in every), max(x for x, _ in every)
    y_low, y_high = _y_range(drawn, log=log, from_zero=from_zero)

    def to_x(x: float) -> float:
        return LEFT + (x - x_low) / (x_high - x_low) * (WIDTH - LEFT - RIGHT)

    def to_y(y: float) -> float:
        low, high, value = (math.log(v) for v in (y_low, y_high, y)) if log else (y_low, y_high, y)
        share = min(1.0, max(0.0, (value - low) / (high - low)))
        return HEIGHT - BOTTOM - share * (HEIGHT - TOP - BOTTOM)

    y_ticks = log_ticks(y_low, y_high) if log else nice_ticks(y_low, y_high)
    if len(y_ticks) < 2:  # less than a factor of two between the limits
        y_ticks = nice_ticks(y_low, y_high, 4)
    parts = [axes(nice_ticks(x_low, x_high, 5), y_ticks, to_x, to_y, x_unit)]
    parts.append(_marks([m for m in marks if x_low <= m.x <= x_high], to_x))
    hover: list[tuple[float, float, str]] = []
    for number, (one, points) in enumerate(drawn, start=1):
        if one.dots:
            parts.append(_dots(points, to_x, to_y, number))
            middle = points
        else:
            buckets = _bucketed(points, x_low, x_high)
            parts.append(_band(buckets, to_x, to_y, number))
            middle = [(x, mean) for x, mean, _, _ in buckets]
            parts.append(_line(middle, to_x, to_y, number))
        hover += [
            (
                round(to_x(x), 1),
                round(to_y(y), 1),
                f"{short_number(y)} at {short_number(x)} {x_unit}",
            )
            for x, y in middle
        ]
    return chart_svg(label, "".join(parts), hover)


def legend(series: Sequence[Series]) -> str:
    """Names of several curves with their colours; empty for a single one."""
    if len(series) < 2:
        return ""
    items = (
        f'<span class="key k{n}">{html.escape(s.label)}</span>'
        for n, s in enumerate(series, start=1)
    )
    return f'<div class="keys">{"".join(items)}</div>'


_Bucket = tuple[float, float, float, float]


def _y_range(
    drawn: Sequence[tuple[Series, list[_Point]]], *, log: bool, from_zero: bool
) -> tuple[float, float]:
    """Limits of the y axis, without isolated spikes of noisy curves."""
    low, high = math.inf, -math.inf
    for one, points in drawn:
        values = sorted(y for _, y in points)
        if not values:
            continue
        spare = 0 if one.dots else len(values) // 200
        low, high = min(low, values[spare]), max(high, values[-1 - spare])
    if log:
        return (low / 1.1, high * 1.1) if high > low else (low / 2, high * 2)
    if from_zero:
        low = min(0.0, low)
    margin = 0.06 * (high - low) or max(1e-6, 0.1 * abs(high))
    return (low if from_zero else low - margin), high + margin


def axes(
    x_ticks: Sequence[float], y_ticks: Sequence[float], to_x: _Scale, to_y: _Scale, x_unit: str
) -> str:
    """Lines and numbers of the axes; `to_x` and `to_y` map values to positions."""
    parts = []
    for y in y_ticks:
        at = f"{to_y(y):.1f}"
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{at}" y2="{at}"/>')
        parts.append(f'<text class="tick" x="{LEFT - 7}" y="{at}" dy=".33em" text-anchor="end">')
        parts.append(f"{short_number(y)}</text>")
    base = HEIGHT - BOTTOM
    parts.append(f'<line class="axis" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{base}" y2="{base}"/>')
    for x in x_ticks:
        parts.append(
            f'<text class="tick" x="{to_x(x):.1f}" y="{base + 15}" text-anchor="middle">'
            f"{short_number(x)}</text>"
        )
    parts.append(
        f'<text class="unit" x="{WIDTH - RIGHT}" y="{HEIGHT - 4}" text-anchor="end">'
        f"{html.escape(x_unit)}</text>"
    )
    return "".join(parts)


def chart_svg(label: str, parts: str, hover: Sequence[tuple[float, float, str]]) -> str:
    """The complete `<svg>` element.

    Args:
        label: Description, for screen readers.
        parts: SVG elements of the chart.
        hover: Positions and the texts shown there under the mouse.
    """
    data = html.escape(json.dumps(hover, separators=(",", ":")), quote=True)
    return (
        f'<svg class="chart" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
        f'aria-label="{html.escape(label, quote=True)}" data-hover="{data}">{parts}'
        '<g class="cursor" visibility="hidden"><line/><circle r="4"/><text/></g></svg>'
    )


def _marks(marks: Sequence[Mark], to_x: _Scale) -> str:
    """A dashed line for each mark; labels that overlap the previous one are left out."""
    parts, free = [], -math.inf
    for mark in sorted(marks, key=lambda m: m.x):
        at, base = to_x(mark.x), HEIGHT - BOTTOM
        parts.append(f'<line class="mark" x1="{at:.1f}" x2="{at:.1f}" y1="{TOP}" y2="{base}">')
        parts.append(f"<title>{html.escape(mark.label)}</title></line>")
        width = _LETTER * len(mark.label)
        if at - width / 2 >= free and at + width / 2 <= WIDTH:
            parts.append(f'<text class="mark-label" x="{at:.1f}" y="{TOP - 4}" ')
            parts.append(f'text-anchor="middle">{html.escape(mark.label)}</text>')
            free = at + width / 2
    return "".join(parts)


def _bucketed(points: list[_Point], x_low: float, x_high: float) -> list[_Bucket]:
    """(x, mean, lowest, highest) of the points in equal intervals of x; at most `_BUCKETS`."""
    buckets: dict[int, list[_Point]] = {}
    for x, y in points:
        place = min(_BUCKETS - 1, int((x - x_low) / (x_high - x_low) * _BUCKETS))
        buckets.setdefault(place, []).append((x, y))
    rows = []
    for place in sorted(buckets):
        xs, ys = zip(*buckets[place], strict=True)
        rows.append((sum(xs) / len(xs), sum(ys) / len(ys), min(ys), max(ys)))
    return rows


def _path(points: Sequence[_Point], to_x: _Scale, to_y: _Scale) -> str:
    return "L".join(f"{to_x(x):.1f} {to_y(y):.1f}" for x, y in points)


def _line(points: list[_Point], to_x: _Scale, to_y: _Scale, number: int) -> str:
    return f'<path class="line s{number}" d="M{_path(points, to_x, to_y)}"/>' if points else ""


def _band(buckets: list[_Bucket], to_x: _Scale, to_y: _Scale, number: int) -> str:
    if not any(high > low for _, _, low, high in buckets):
        return ""
    upper = [(x, high) for x, _, _, high in buckets]
    lower = [(x, low) for x, _, low, _ in reversed(buckets)]
    return f'<path class="band s{number}" d="M{_path(upper + lower, to_x, to_y)}Z"/>'


def _dots(points: list[_Point], to_x: _Scale, to_y: _Scale, number: int) -> str:
    circles = "".join(
        f'<circle class="dot s{number}" cx="{to_x(x):.1f}" cy="{to_y(y):.1f}" r="3.5"/>'
        for x, y in points
    )
    return _line(points, to_x, to_y, number) + circles
