"""Figures for documents: curves and points on linear or logarithmic axes, as standalone SVG."""

import html
import math
from collections.abc import Callable, Sequence

from .curves import Series, log_ticks, nice_ticks, short_number

_PLOT, _HEIGHT = 450, 400
"""Right end of the axes, and total height; the legend is to the right."""
_LEFT, _TOP, _BOTTOM = 62, 40, 48
_LETTER = 7.2
"""Mean width of a letter, px."""
_COLORS = (
    "#2f6fde", "#d9541e", "#2a8c4a", "#8a4fc9", "#b8860b", "#008b9a", "#c2185b", "#666b76",
    "#6b8e23", "#1d1f24",
)  # fmt: skip
_STYLE = (
    "text{font:12px system-ui,sans-serif;fill:#444}.t{font-size:14px;font-weight:600;fill:#1d1f24}"
    ".g{stroke:#e2e0da}.a{stroke:#666b76}.l{fill:none;stroke-width:2;stroke-linejoin:round}"
)


def figure(
    series: Sequence[Series],
    *,
    title: str,
    x_label: str,
    y_label: str,
    log_x: bool = False,
    log_y: bool = False,
) -> str:
    """One figure as an SVG document.

    Args:
        series: Curves over a common x axis; `dots` marks each point.
        title: Text above the plot.
        x_label: Quantity and unit of the x axis.
        y_label: Quantity and unit of the y axis.
        log_x: Logarithmic x axis; points that are not positive are left out.
        log_y: The same for the y axis.

    Raises:
        ValueError: there is nothing to draw.
    """
    drawn = [
        (s, [(x, y) for x, y in s.points if (x > 0 or not log_x) and (y > 0 or not log_y)])
        for s in series
    ]
    xs = [x for _, points in drawn for x, _ in points]
    ys = [y for _, points in drawn for _, y in points]
    if not xs:
        raise ValueError(f"The figure {title!r} has no points.")
    to_x, x_ticks = _axis(xs, log=log_x, start=_LEFT, end=_PLOT)
    to_y, y_ticks = _axis(ys, log=log_y, start=_HEIGHT - _BOTTOM, end=_TOP)
    width = round(_PLOT + 48 + _LETTER * max(len(s.label) for s in series))
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {_HEIGHT}" '
        f'width="{width}" height="{_HEIGHT}"><metadata>gscore</metadata><style>{_STYLE}</style>'
        '<rect width="100%" height="100%" fill="#fff"/>',
        f'<text class="t" x="{_LEFT}" y="22">{html.escape(title)}</text>',
        *_grid(to_x, x_ticks, to_y, y_ticks),
        f'<text x="{_PLOT}" y="{_HEIGHT - 10}" text-anchor="end">{html.escape(x_label)}</text>',
        f'<text x="{_LEFT - 48}" y="{_TOP - 6}">{html.escape(y_label)}</text>',
    ]
    for number, (one, points) in enumerate(drawn):
        color = _COLORS[number % len(_COLORS)]
        places = [(to_x(x), to_y(y)) for x, y in points]
        if len(places) > 1:
            path = "L".join(f"{x:.1f} {y:.1f}" for x, y in places)
            parts.append(f'<path class="l" stroke="{color}" d="M{path}"/>')
        if one.dots:
            parts += [
                f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{color}"/>' for x, y in places
            ]
        y = _TOP + 8 + 18 * number
        x = _PLOT + 14
        parts.append(f'<rect x="{x}" y="{y - 5}" width="12" height="4" fill="{color}"/>')
        parts.append(f'<text x="{x + 18}" y="{y}" dy=".1em">{html.escape(one.label)}</text>')
    return "".join(parts) + "</svg>\n"


_Scale = Callable[[float], float]


def _axis(
    values: Sequence[float], *, log: bool, start: float, end: float
) -> tuple[_Scale, list[float]]:
    """Map from values to positions between `start` and `end`, and the values of the ticks."""
    low, high = min(values), max(values)
    if log:
        spare = (high / low) ** 0.04 if high > low else 2.0
        low, high = low / spare, high * spare
        ticks = log_ticks(low, high)
        if len(ticks) > 9:
            ticks = [t for t in ticks if math.isclose(math.log10(t) % 1, 0, abs_tol=1e-9)] or ticks
        if len(ticks) < 3:  # less than a factor of ten or so
            ticks = nice_ticks(low, high)
    else:
        spare = 0.04 * (high - low) or 0.1 * abs(high) or 1.0
        low, high = low - spare, high + spare
        ticks = nice_ticks(low, high)

    def place(value: float) -> float:
        if log:
            share = math.log(value / low) / math.log(high / low)
        else:
            share = (value - low) / (high - low)
        return start + share * (end - start)

    return place, ticks


def _grid(
    to_x: _Scale, x_ticks: Sequence[float], to_y: _Scale, y_ticks: Sequence[float]
) -> list[str]:
    base, right = _HEIGHT - _BOTTOM, _PLOT
    parts = []
    for tick in y_ticks:
        at = f"{to_y(tick):.1f}"
        parts.append(f'<line class="g" x1="{_LEFT}" x2="{right}" y1="{at}" y2="{at}"/>')
        parts.append(
            f'<text x="{_LEFT - 7}" y="{at}" dy=".33em" text-anchor="end">'
            f"{short_number(tick)}</text>"
        )
    for tick in x_ticks:
        at = f"{to_x(tick):.1f}"
        parts.append(f'<line class="g" x1="{at}" x2="{at}" y1="{_TOP}" y2="{base}"/>')
        parts.append(
            f'<text x="{at}" y="{base + 16}" text-anchor="middle">{short_number(tick)}</text>'
        )
    parts.append(f'<line class="a" x1="{_LEFT}" x2="{right}" y1="{base}" y2="{base}"/>')
    return parts
