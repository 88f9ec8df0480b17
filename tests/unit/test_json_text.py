"""JSON of other programs; oracles: its grammar, and the syntax trees."""

import math
from pathlib import Path

import pytest

import gscore
from gscore.json_text import parse_json

PACKAGE = Path(gscore.__file__).parent


@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_text_and_bytes_with_and_without_mark(mark: str) -> None:
    """Oracle: the written value."""
    text = mark + '{"a": [1, 2.5, null]}'
    assert parse_json(text) == parse_json(text.encode()) == {"a": [1, 2.5, None]}


@pytest.mark.parametrize("digits", [400, 5000])
def test_numbers_beyond_floats_are_infinite(digits: int) -> None:
    """Oracle: IEEE 754; shorter ones are exact."""
    assert parse_json("[" + "9" * digits + "]") == [math.inf]
    assert parse_json("[-" + "9" * digits + "]") == [-math.inf]
    assert parse_json("9" * 60) == 10**60 - 1


@pytest.mark.parametrize("text", ["", "x", "[" * 100_000, b"\xff\xfe\xff", '{"a": 1} 2'])
def test_everything_else_is_a_value_error(text: str | bytes) -> None:
    """Oracle: the one kind of error."""
    with pytest.raises(ValueError, match=r"."):
        parse_json(text)


def test_nobody_else_parses_json() -> None:
    """Oracle: the sources."""
    files = [path for path in PACKAGE.rglob("*.py") if path.name != "json_text.py"]
    assert not [path for path in files if "json.loads(" in path.read_text(encoding="utf-8")]
