"""Wrapping of pages; oracle: pages whose wrapped form is plain to see, and the words of ours."""

import sys
from pathlib import Path

import pytest

from tests.docs.test_links import PAGES, ROOT, too_wide

sys.path.insert(0, str(ROOT / "tools" / "build"))

from wrap_text import wrap

from tests.for_each import for_each

LONG = "word " * 30


def test_only_what_is_too_wide_changes() -> None:
    """Oracle: a page of everything that is no prose, and a paragraph that fits."""
    page = (
        f"# {LONG}\n\nshort\nlines stay\n\n| {LONG}|\n\n```\n{LONG}\n```\n\n"
        f"![{LONG}](a.png)\n\n- one\n- two\n"
    )
    assert wrap(page) == page


def words(count: int) -> str:
    """So many words in a line."""
    return " ".join(["word"] * count)


def test_paragraphs_and_items_keep_their_indent() -> None:
    """Oracle: 23 words of five columns fit beside two of indent, 24 without."""
    assert wrap(LONG.strip() + "\n") == f"{words(24)}\n{words(6)}\n"
    assert wrap(f"- {LONG}\n- next\n") == f"- {words(23)}\n  {words(7)}\n- next\n"


@pytest.mark.parametrize("tail", ["- b", "98 %", "1. c", "# d", "`x y z`", "12 dB,"])
def test_no_line_begins_with_what_markdown_would_read_otherwise(tail: str) -> None:
    """Oracle: a text cut at many columns; signs, units and code stay with the word before."""
    starts = set()
    for room in range(100, 122):
        lines = wrap("a" * room + f" {tail} " + "b" * 40 + "\n").splitlines()
        assert len(lines) in (2, 3)
        starts |= {line.split()[0] for line in lines[1:]}
    assert not starts & {"-", "#", "1.", "%", "dB,", "y", "z`"} and len(starts) > 1


@for_each(PAGES)
def test_our_pages_keep_their_words(page: Path) -> None:
    """Oracle: the words in their order; what is wrapped once stays."""
    text = page.read_text(encoding="utf-8")
    wrapped = wrap(text)
    assert wrapped.split() == text.split() and wrap(wrapped) == wrapped
    assert [line for line in too_wide(wrapped) if "`" not in line] == []


@for_each(PAGES)
def test_no_line_of_a_paragraph_becomes_a_quote(page: Path) -> None:
    """Oracle: a quote that is meant begins after an empty line."""
    lines = page.read_text(encoding="utf-8").splitlines()
    pairs = zip(["", *lines], lines, strict=False)
    odd = [
        line
        for before, line in pairs
        if _is_quote(line) and before.strip() and not _is_quote(before)
    ]
    assert odd == []


def _is_quote(line: str) -> bool:
    return line.lstrip().startswith(">")
