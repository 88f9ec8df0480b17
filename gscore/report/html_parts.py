"""HTML parts of all pages: the frame without external resources, switches, warnings."""

import html
from collections.abc import Sequence
from pathlib import Path

from ..io.files import atomic_write

AXES = (("step", "steps"), ("elapsed_s", "seconds"))
"""The switch of curves: the key of a row that lies to the right, and its name."""


def whole_page(
    title: str, body: str, *, styles: Sequence[str] = (), scripts: Sequence[str] = ()
) -> str:
    """A page that stands alone.

    Args:
        title: Of the window.
        body: HTML.
        styles: Files beside this one, after report.css.
        scripts: The same, after charts.js.
    """
    css = "".join(map(_asset, ("report.css", *styles)))
    js = "".join(map(_asset, ("charts.js", *scripts)))
    return (
        '<!doctype html>\n<!-- written by gscore -->\n<html lang="en">\n<head>\n'
        '<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>\n{css}</style>\n</head>\n<body>\n<main>\n"
        f"{body}</main>\n<script>\n{js}</script>\n</body>\n</html>\n"
    )


def write_html(path: Path, page: str) -> None:
    """Write a page completely or not at all.

    Raises:
        GsError: the file cannot be written.
    """
    # Names of files may hold bytes that are no UTF-8.
    atomic_write(path, page.encode("utf-8", "backslashreplace"))


def warnings_html(sentences: Sequence[str]) -> str:
    """A section with a list; nothing where there are none."""
    if not sentences:
        return ""
    items = "".join(f"<li>{html.escape(s)}</li>" for s in sentences)
    return f'<section class="warnings"><h2>Warnings</h2><ul>{items}</ul></section>\n'


def switch(kind: str, label: str, choices: Sequence[tuple[str, str]]) -> str:
    """Buttons of which one is pressed, the first at the beginning.

    Args:
        kind: What scripts know them by, `data-KIND`.
        label: For screen readers.
        choices: Value and words.
    """
    buttons = "".join(
        f'<button data-{kind}="{html.escape(value, quote=True)}" '
        f'aria-pressed="{"false" if place else "true"}">{html.escape(words)}</button>'
        for place, (value, words) in enumerate(choices)
    )
    return f'<div class="switch" role="group" aria-label="{html.escape(label)}">{buttons}</div>'


def _asset(name: str) -> str:
    return Path(__file__).with_name(name).read_text(encoding="utf-8")
