"""Compare page of `gscore compare`: renders under a slider, tables of differences, curves."""

import html
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..metrics.comparison import HIGHER_IS_BETTER, RunComparison, ViewPair
from ..text_format import count_text, number, number_text, size_text, time_text
from .curves import Series, clean_points, legend, line_chart
from .html_parts import AXES, html_page, switch, warnings_html

_DIGITS = {"psnr": 2, "ssim": 4, "lpips": 4}
_AXES = (("step", "steps"), ("elapsed_s", "s"))


@dataclass(frozen=True, kw_only=True)
class PairPictures:
    """Thumbnails of a view with equal sizes, as data URIs."""

    name: str
    width: int
    height: int
    first: str
    second: str
    photo: str


def comparison_html(
    comparison: RunComparison, pictures: Sequence[PairPictures], *, title: str
) -> str:
    """The page as HTML.

    Args:
        comparison: Content of the page.
        pictures: Pictures of all pairs or some.
        title: Usually the name of the capture.
    """
    body = "".join(
        (
            _head(comparison, title),
            warnings_html(comparison.warnings),
            _means_table(comparison),
            _curves(comparison),
            _cards(comparison, pictures),
            _views_table(comparison),
            _only_one(comparison),
            _options(comparison),
        )
    )
    return html_page(
        f"{title}: two runs compared by gscore",
        body,
        styles=("compare.css",),
        scripts=("compare.js",),
    )


def names_of(comparison: RunComparison) -> dict[str, str]:
    """Labels of the metrics of a comparison."""
    return {"psnr": comparison.psnr_name, "ssim": "SSIM", "lpips": "LPIPS"}


def _labels(comparison: RunComparison) -> tuple[str, str]:
    first, second = (html.escape(run.label) for run in comparison.runs)
    return first, second


def _head(comparison: RunComparison, title: str) -> str:
    rows = "".join(
        f'<p class="sub"><b class="run r{n}">{html.escape(run.label)}</b></p>'
        + (f'<pre class="command">{html.escape(run.command)}</pre>' if run.command else "")
        for n, run in enumerate(comparison.runs, start=1)
    )
    views = count_text(len(comparison.pairs), "view")
    return (
        f'<header><h1>{html.escape(title)}</h1><p class="sub">Two runs compared on {views} '
        f"measured in both</p>{rows}</header>\n"
    )


def _means_table(comparison: RunComparison) -> str:
    rows = [
        _row(name, values, _DIGITS[key], better=_better(key))
        for key, name in names_of(comparison).items()
        if (values := comparison.means.get(key)) is not None
    ]
    for key, name, words in _WORK:
        values = [run.metrics.get(key) for run in comparison.runs]
        if any(value is not None for value in values):
            cells = "".join(f"<td>{html.escape(words(value))}</td>" for value in values)
            rows.append(f"<tr><th>{name}</th>{cells}<td>{_ratio(*values)}</td></tr>")
    first, second = _labels(comparison)
    return (
        '<section><h2>Numbers</h2><p class="hint">Means over the views measured in both runs; '
        'green is better.</p><div class="wide"><table class="numbers"><thead><tr><th></th>'
        f"<th>{first}</th><th>{second}</th><th>difference</th></tr></thead><tbody>"
        f"{''.join(rows)}</tbody></table></div></section>\n"
    )


_WORK: tuple[tuple[str, str, Callable[[Any], str]], ...] = (
    ("splats", "Splats", number),
    ("models", "Merged models", number),
    ("storage_bytes", "Storage", size_text),
    ("steps", "Steps", number),
    ("train_seconds", "Training", time_text),
    ("fps", "Rendering, pictures per second", lambda value: number_text(value, 1)),
    ("peak_memory_bytes", "Peak memory", size_text),
)
"""Key in metrics.json, name, and formatter."""


def _ratio(first: float | None, second: float | None) -> str:
    if not first or second is None:
        return ""
    return f"{100 * (second / first - 1):+.1f} %"


def _better(key: str) -> int:
    return 1 if HIGHER_IS_BETTER[key] else -1


def _row(name: str, values: tuple[float, float], digits: int, *, better: int) -> str:
    cells = "".join(f"<td>{value:.{digits}f}</td>" for value in values)
    return f"<tr><th>{html.escape(name)}</th>{cells}{_change(values, digits, better)}</tr>"


def _change(values: tuple[float, float], digits: int, better: int) -> str:
    """A cell with second minus first, coloured unless zero."""
    change = round(values[1] - values[0], digits)
    kind = "" if change == 0 else ' class="gain"' if change * better > 0 else ' class="loss"'
    return f"<td{kind}>{change:+.{digits}f}</td>"


def _curves(comparison: RunComparison) -> str:
    figures = "".join(
        _figure(comparison, *what)
        for what in (
            ("PSNR of the training views (dB)", "history", "psnr", False, False),
            ("PSNR of the measured views (dB)", "evals", "psnr", False, False),
            ("Loss", "history", "loss", True, False),
            ("Splats", "history", "splats", False, True),
        )
    )
    if not figures:
        return ""
    axes = switch("axis", "Horizontal axis", AXES)
    return (
        f'<section id="curves" data-axis="step"><div class="bar"><h2>Training</h2>{axes}</div>'
        f'<div class="plots pairs">{figures}</div></section>\n'
    )


def _figure(
    comparison: RunComparison, name: str, rows: str, key: str, log: bool, from_zero: bool
) -> str:
    """Both curves over steps, and over seconds; empty if neither run has one."""
    charts, keys = [], ""
    for axis, unit in _AXES:
        series = [
            Series(
                label=run.label,
                points=clean_points(
                    [(row.get(axis), row.get(key)) for row in run.metrics.get(rows) or []]
                ),
                dots=rows == "evals",
            )
            for run in comparison.runs
        ]
        if max(len(one.points) for one in series) < 2:
            return ""
        svg = line_chart(series, label=name, x_unit=unit, log=log, from_zero=from_zero)
        charts.append(f'<div class="by-{axis}">{svg}</div>')
        keys = keys or legend(series)
    scale = " <small>log scale</small>" if log else ""
    return f'<figure class="plot"><h3>{name}{scale}</h3>{keys}{"".join(charts)}</figure>'


def _cards(comparison: RunComparison, pictures: Sequence[PairPictures]) -> str:
    if not pictures:
        return ""
    by_name = {pair.name: pair for pair in comparison.pairs}
    first, second = (run.label for run in comparison.runs)
    names = names_of(comparison)
    cards = "".join(
        _card(picture, by_name[picture.name], place, (first, second), names)
        for place, picture in enumerate(pictures)
    )
    sides = switch(
        "sides",
        "Left and right picture",
        (
            ("first second", f"{first} | {second}"),
            ("photo first", f"photo | {first}"),
            ("photo second", f"photo | {second}"),
        ),
    )
    order = switch(
        "order", "Order", (("name", "by name"), ("loss", "losses first"), ("gain", "gains first"))
    )
    left_out = len(comparison.pairs) - len(pictures)
    note = ""
    if left_out:
        views = count_text(len(comparison.pairs), "view")
        note = f" Pictures of {len(pictures)} of {views}."
    return (
        f'<section id="views" data-sides="first second"><div class="bar"><h2>Views</h2>{order}'
        f'</div>{sides}<p class="hint">Drag over a picture, or move its slider with the arrow '
        f'keys.{note}</p><div id="cards">{cards}</div></section>\n'
    )


def _card(
    picture: PairPictures,
    pair: ViewPair,
    place: int,
    labels: tuple[str, str],
    names: Mapping[str, str],
) -> str:
    name = html.escape(pair.name, quote=True)
    psnr = pair.numbers.get("psnr")
    change = "" if psnr is None else f"{psnr[1] - psnr[0]:.6f}"
    images = "".join(
        f'<img class="{kind}" src="{uri}" width="{picture.width}" height="{picture.height}" '
        f'draggable="false" alt="{words} of {name}">'
        for kind, uri, words in (
            ("first", picture.first, f"render by {html.escape(labels[0])}"),
            ("second", picture.second, f"render by {html.escape(labels[1])}"),
            ("photo", picture.photo, "photo"),
        )
    )
    words = " · ".join(
        f"{names[key]} {values[0]:.{_DIGITS[key]}f} → <b>{values[1]:.{_DIGITS[key]}f}</b>"
        for key, values in pair.numbers.items()
    )
    return (
        f'<article data-number="{place}" data-change="{change}"><h3>{name}</h3><p>{words}</p>'
        f'<div class="slider" style="--at:50%;aspect-ratio:{picture.width}/{picture.height}">'
        f'{images}<input type="range" min="0" max="100" value="50" step="0.5" '
        f'aria-label="Border between both pictures of {name}"></div></article>'
    )


def _views_table(comparison: RunComparison) -> str:
    names = names_of(comparison)
    keys = [key for key in names if any(key in pair.numbers for pair in comparison.pairs)]
    first, second = _labels(comparison)
    head = "".join(
        f"<th>{names[key]} {first}</th><th>{second}</th><th>difference</th>" for key in keys
    )
    rows = "".join(
        f"<tr><th>{html.escape(pair.name)}</th>"
        + "".join(_cells(pair.numbers.get(key), key) for key in keys)
        + "</tr>"
        for pair in comparison.pairs
    )
    return (
        '<details><summary>Numbers of every view</summary><div class="wide"><table>'
        f"<thead><tr><th>view</th>{head}</tr></thead><tbody>{rows}</tbody></table></div></details>\n"
    )


def _cells(values: tuple[float, float] | None, key: str) -> str:
    if values is None:
        return "<td>n/a</td><td>n/a</td><td></td>"
    digits = _DIGITS[key]
    cells = "".join(f"<td>{value:.{digits}f}</td>" for value in values)
    return cells + _change(values, digits, _better(key))


def _only_one(comparison: RunComparison) -> str:
    parts = []
    for run, names in zip(comparison.runs, comparison.only_in, strict=True):
        if names:
            listed = html.escape("\n".join(names))
            views = count_text(len(names), "view")
            parts.append(
                f"<details><summary>{views} measured only in {html.escape(run.label)}</summary>"
                f"<pre>{listed}</pre></details>"
            )
    return f'<section class="details">{"".join(parts)}</section>\n' if parts else ""


def _options(comparison: RunComparison) -> str:
    if not comparison.options:
        return ""
    first, second = _labels(comparison)
    rows = "".join(
        f"<tr><th>{html.escape(name)}</th>"
        + "".join(f"<td>{html.escape(str(value))}</td>" for value in values)
        + "</tr>"
        for name, values in comparison.options.items()
    )
    return (
        '<details open><summary>Options that differ</summary><div class="wide"><table><thead><tr>'
        f"<th>option</th><th>{first}</th><th>{second}</th></tr></thead><tbody>{rows}</tbody>"
        "</table></div></details>\n"
    )
