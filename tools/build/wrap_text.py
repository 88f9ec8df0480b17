"""Text wrapping of Markdown paragraphs with lines of more than 120 columns.

`python tools/build/wrap_text.py README.md docs/*.md`; `make format` runs it on every page. Code,
tables, headings and narrow paragraphs are not changed.
"""

import re
import sys
from pathlib import Path

WIDEST = 120
_FENCE = re.compile(r"^\s*(```|~~~)")
_ITEM = re.compile(r"^(\s*)([-*+]|\d+[.)])(\s+)")
_KEPT = re.compile(r"^\s*(\||#|<|>|!\[|\[[^\]]+\]:)|^\s*$|  $")
"""Tables, headings, HTML, quotes, pictures, link targets, empty lines and forced breaks."""
_UNSPLIT = re.compile(
    r"(?:`[^`]{1,60}`|\S)+"
    r"(?: (?:[-+*>#]|\d+[.)]|%|dB|px|ms|s|MB|GB)(?=[\s.,;:)]|$)[.,;:)]*)*"
)
"""A word with the units and signs after it, which must not begin a line; short text in backticks is
one word."""


def wrap(text: str) -> str:
    """The text of a page, wrapped."""
    lines: list[str] = []
    block: list[str] = []
    fenced = False
    for line in text.splitlines():
        fence = _FENCE.match(line) is not None
        if fenced or fence or _KEPT.search(line) or _ITEM.match(line):
            lines += _wrapped(block)
            block = []
        if fence:
            fenced = not fenced
        if fenced or fence or _KEPT.search(line):
            lines.append(line)
        else:
            block.append(line)
    return "\n".join([*lines, *_wrapped(block)]) + "\n"


def _wrapped(block: list[str]) -> list[str]:
    """The lines of one paragraph or list item."""
    if all(len(line) <= WIDEST for line in block):
        return block
    item = _ITEM.match(block[0])
    first = item[0] if item else block[0][: len(block[0]) - len(block[0].lstrip())]
    rest = " " * len(first)
    words = _UNSPLIT.findall(" ".join(block)[len(first) :])
    lines, line = [], first + words[0]
    for word in words[1:]:
        if len(line) + 1 + len(word) > WIDEST:
            lines.append(line)
            line = rest + word
        else:
            line += " " + word
    return [*lines, line]


def main(arguments: list[str]) -> int:
    """Wrap the given files."""
    for path in map(Path, arguments):
        text = path.read_text(encoding="utf-8")
        wrapped = wrap(text)
        if wrapped != text:
            path.write_text(wrapped, encoding="utf-8")
            print(f"wrapped {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
