"""Counts in sentences: one way to write them, found in the syntax trees."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from gscore.text_format import count_text, number
from tests.for_each import for_each

PACKAGE = Path(__file__).parents[2] / "gscore"
_LARGE = re.compile(r" (splats|steps|points|threads|photos|cameras|frames)\b")
"""Nouns that may be counted in thousands, or be one."""


@pytest.mark.parametrize(
    ("count", "words"),
    [(0, "0 views"), (1, "1 view"), (2, "2 views"), (42691, "42,691 views")],
)
def test_counts_have_their_plural_and_commas(count: int, words: str) -> None:
    """Oracle: English."""
    assert count_text(count, "view") == words


def test_other_words_than_an_s() -> None:
    """Oracle: English."""
    assert count_text(1, "photo is", "photos are") == "1 photo is"
    assert count_text(1200, "photo is", "photos are") == "1,200 photos are"


def test_numbers() -> None:
    """Oracle: the digits in threes; no digits for unknown numbers."""
    assert [number(n) for n in (7, 999, 1000, 1234567, None)] == [
        "7",
        "999",
        "1,000",
        "1,234,567",
        "n/a",
    ]


@for_each(sorted(PACKAGE.rglob("*.py")))
def test_counts_are_written_by_the_helpers(path: Path) -> None:
    """Oracle: the syntax tree: no thousands separator, and no bare number before a plural."""
    if path.name == "text_format.py":
        return
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = [f"{path.name}:{line}: {what}" for line, what in _own_ways(tree)]
    assert not found, "use gscore.text_format"


def _own_ways(tree: ast.AST) -> Iterator[tuple[int, str]]:
    for node in ast.walk(tree):
        if not isinstance(node, ast.JoinedStr):
            continue
        for part, after in zip(node.values, [*node.values[1:], None], strict=True):
            if not isinstance(part, ast.FormattedValue):
                continue
            spec = ast.unparse(part.format_spec) if part.format_spec else ""
            if "," in spec:
                yield part.lineno, "a thousands separator"
            text = after.value if isinstance(after, ast.Constant) else ""
            if not spec and isinstance(part.value, ast.Name | ast.Attribute | ast.Subscript):
                bare = _LARGE.match(str(text))
                if bare:
                    yield part.lineno, f"{ast.unparse(part.value)}{bare[0]}"
            if _is_len(part.value) and _LARGE.match(str(text)):
                yield part.lineno, ast.unparse(part.value)


def _is_len(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and getattr(node.func, "id", "") == "len"
