"""Manual page of the add-on: pages of docs/ as one web page inside the extension, without pictures
and external resources."""

import html
import os
import re
from pathlib import Path, PurePosixPath

PAGES = (
    "blender.md",
    "blender/install.md",
    "blender/cameras.md",
    "blender/training.md",
    "blender/steering.md",
    "blender/splats.md",
    "blender/editing.md",
    "blender/rendering.md",
    "blender/sequences.md",
    "blender/scripts.md",
    "blender/troubleshooting.md",
)
"""Files of docs/, in order; their headings are unique."""

_STYLE = (
    "body{max-width:52em;margin:2em auto;padding:0 1em;font:16px/1.5 sans-serif}"
    "code,pre{background:#8882;padding:.1em .3em}pre{padding:.6em;overflow:auto}"
    "table{border-collapse:collapse}td,th{border:1px solid #888;padding:.3em .6em;text-align:left}"
)
_PICTURE = re.compile(r"^\s*!\[[^\]]*\]\([^)]*\)$")
_ITEM = re.compile(r"^(\s*)(-|\d+\.) (.*)$")


def manual(docs: Path) -> str:
    """The joined Markdown of all pages; links between them become links to headings."""
    texts = {name: (docs / name).read_text(encoding="utf-8") for name in PAGES}
    first = {name: anchor(text.splitlines()[0].lstrip("# ")) for name, text in texts.items()}

    def inside(text: str, folder: PurePosixPath) -> str:
        def link(found: re.Match[str]) -> str:
            page = os.path.normpath(folder / found[1])
            return f"](#{found[2] or first[page]})" if page in first else found[0]

        return re.sub(r"\]\(([^):#]+\.md)(?:#([^)]*))?\)", link, text)

    return "\n".join(inside(text, PurePosixPath(name).parent) for name, text in texts.items())


def manual_page(markdown: str) -> str:
    """Convert the Markdown subset of docs/ to HTML: headings, paragraphs, lists, tables, code.

    Links to other files of docs/ become plain text; links within the page are kept.
    """
    blocks, lines = [], iter([*markdown.splitlines(), ""])
    paragraph: list[str] = []

    def close() -> None:
        if paragraph:
            blocks.append(_paragraph(paragraph))
            paragraph.clear()

    for line in lines:
        if line.lstrip().startswith("```"):
            close()
            code = []
            while not (line := next(lines)).lstrip().startswith("```"):
                code.append(line)
            blocks.append(f"<pre>{html.escape(chr(10).join(code))}</pre>")
        elif line.startswith("#"):
            close()
            marks, _, title = line.partition(" ")
            blocks.append(f'<h{len(marks)} id="{anchor(title)}">{_inline(title)}</h{len(marks)}>')
        elif not line.strip() or _PICTURE.match(line):
            close()
        elif paragraph and (_ITEM.match(line) or _is_row(line) != _is_row(paragraph[0])):
            close()
            paragraph.append(line)
        else:
            paragraph.append(line)
    head = f'<meta charset="utf-8"><title>Train Splats</title><style>{_STYLE}</style>'
    body = "\n".join(blocks)
    return f"<!doctype html>\n<html><head>{head}</head><body>\n{body}\n</body></html>\n"


def anchor(title: str) -> str:
    """The id of a heading, as on GitHub."""
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")


def _is_row(line: str) -> bool:
    return line.lstrip().startswith("|")


def _paragraph(lines: list[str]) -> str:
    if _is_row(lines[0]):
        return _table(lines)
    text = " ".join(line.strip() for line in lines)
    item = _ITEM.match(lines[0])
    if item is None:
        return f"<p>{_inline(text)}</p>"
    mark = "&bull;" if item[2] == "-" else item[2]
    return f"<p>{mark} {_inline(text.partition(' ')[2])}</p>"


def _table(lines: list[str]) -> str:
    rows = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines]
    body = [row for row in rows if not all(re.fullmatch(r":?-+:?", cell) for cell in row)]
    parts = []
    for place, row in enumerate(body):
        tag = "td" if place else "th"
        cells = "".join(f"<{tag}>{_inline(cell)}</{tag}>" for cell in row)
        parts.append(f"<tr>{cells}</tr>")
    return f"<table>{''.join(parts)}</table>"


def _inline(text: str) -> str:
    """HTML of code, bold, italics and links; code is not converted further."""
    parts = re.split(r"`([^`]*)`", text)
    for place, part in enumerate(parts):
        part = html.escape(part, quote=False)
        if place % 2:
            parts[place] = f"<code>{part}</code>"
            continue
        part = re.sub(r"\[([^\]]*)\]\((#[^)]*|https?:[^)]*)\)", r'<a href="\2">\1</a>', part)
        part = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", part)
        part = re.sub(r"\*\*([^*]+)\*\*", r"<b>\1</b>", part)
        parts[place] = re.sub(r"\*([^*]+)\*", r"<i>\1</i>", part)
    return "".join(parts)
