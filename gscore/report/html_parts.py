"""HTML parts of all pages: the frame without external resources, switches, warnings, view.html."""

import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..io.files import atomic_write, read_bytes
from ..option_marks import show_flags

AXES = (("step", "steps"), ("elapsed_s", "seconds"))
"""Choices of the x axis: key of a row, and name."""
MOST_ROWS = 20
"""Maximum number of photos in a table, those with the largest values."""


def html_page(
    title: str, body: str, *, styles: Sequence[str] = (), scripts: Sequence[str] = ()
) -> str:
    """A self-contained page.

    Args:
        title: Title of the window.
        body: HTML; marked options are shown as flags.
        styles: CSS files in this folder, added after report.css.
        scripts: Script files in this folder, added after charts.js.
    """
    css = "".join(map(_asset, ("report.css", *styles)))
    js = "".join(map(_asset, ("charts.js", *scripts)))
    return (
        '<!doctype html>\n<!-- written by gscore -->\n<html lang="en">\n<head>\n'
        '<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>\n{css}</style>\n</head>\n<body>\n<main>\n"
        f"{show_flags(body)}</main>\n<script>\n{js}</script>\n</body>\n</html>\n"
    )


def write_html(path: Path, page: str) -> None:
    """Write a page completely or not at all.

    Raises:
        GsError: the file cannot be written.
    """
    # File names may contain bytes that are not UTF-8.
    atomic_write(path, page.encode("utf-8", "backslashreplace"))


def warnings_html(sentences: Sequence[str]) -> str:
    """A section with a list of warnings; empty without any."""
    if not sentences:
        return ""
    items = "".join(f"<li>{html.escape(s)}</li>" for s in sentences)
    return f'<section class="warnings"><h2>Warnings</h2><ul>{items}</ul></section>\n'


def switch(kind: str, label: str, choices: Sequence[tuple[str, str]]) -> str:
    """Radio buttons, initially with the first one pressed.

    Args:
        kind: Attribute for scripts, `data-KIND`.
        label: Description for screen readers.
        choices: Value and text.
    """
    buttons = "".join(
        f'<button data-{kind}="{html.escape(value, quote=True)}" '
        f'aria-pressed="{"false" if place else "true"}">{html.escape(words)}</button>'
        for place, (value, words) in enumerate(choices)
    )
    return f'<div class="switch" role="group" aria-label="{html.escape(label)}">{buttons}</div>'


def _asset(name: str) -> str:
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


PAGE = "view.html"
"""Default page of `gscore view` in the folder of a run."""
SEAM = "<!-- gscore view -->"
"""Placeholder for the page in a report."""
_SHOWN = (
    f'{SEAM}<section id="page"><h2><a href="{PAGE}">Look around in 3D</a></h2>'
    "<details><summary>Show it here</summary>"
    f'<iframe src="{PAGE}" title="The splats" loading="lazy"></iframe></details></section>\n'
)


def link_page(folder: Path) -> bool:
    """Embed view.html in the report.html of a folder; returns False if there is no report with a
    placeholder.

    Raises:
        GsError: the report cannot be written.
    """
    report = folder / "report.html"
    if not (report.is_file() and (folder / PAGE).is_file()):
        return False
    content = read_bytes(report)
    shown, seam = _SHOWN.encode(), SEAM.encode()
    if shown not in content and content.count(seam) == 1:
        atomic_write(report, content.replace(seam, shown))
    return shown in content or content.count(seam) == 1


def photo_table(heads: Sequence[str], rows: Mapping[str, tuple[Any, ...]]) -> str:
    """Table of photos with bars, in falling order.

    Args:
        heads: Names of the columns.
        rows: By name of the photo the number of the bar, and the text of each column.
    """
    ordered = sorted(rows.items(), key=lambda item: -item[1][0])
    widest = max((number for _, (number, *_) in ordered), default=0.0) or 1.0
    body = "".join(
        f"<tr><td>{html.escape(name)}</td>{''.join(f'<td>{text}</td>' for text in texts)}"
        f'<td><svg width="120" height="10"><rect width="{120 * number / widest:.1f}" '
        f'height="10" fill="currentColor"/></svg></td></tr>'
        for name, (number, *texts) in ordered[:MOST_ROWS]
    )
    columns = "".join(f"<th>{head}</th>" for head in ("photo", *heads, ""))
    return f"<table><thead><tr>{columns}</tr></thead><tbody>{body}</tbody></table>"
