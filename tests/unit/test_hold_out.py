"""`--hold-out`; oracle: the DataConfig fields set by the older options."""

from dataclasses import replace
from pathlib import Path

import pytest

from gscore.config import DataConfig
from gscore.errors import ConfigError
from gscore.hold_out import hold_out_word, parse_hold_out

PLAIN = DataConfig(source=Path("in"))


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        ("6", {"test_every": 6}),
        ("first:10", {"test_first": 10}),
        ("last:3", {"test_last": 3}),
        ("first:1,last:2", {"test_first": 1, "test_last": 2}),
        ("names.txt", {"test_list": Path("names.txt")}),
        ("./6", {"test_list": Path("6")}),
        ("./first:2", {"test_list": Path("first:2")}),
        ("C:\\shots\\test.txt", {"test_list": Path("C:\\shots\\test.txt")}),
        ("a,b.txt", {"test_list": Path("a,b.txt")}),
    ],
)
def test_each_form(text: str, fields: dict) -> None:
    """Oracle: by hand; the text converted back means the same."""
    data = replace(PLAIN, **parse_hold_out(text))
    assert data == replace(PLAIN, **fields)
    assert replace(PLAIN, **parse_hold_out(hold_out_word(data))) == data


def test_the_default_needs_no_word() -> None:
    """Oracle: every eighth view, unless the capture states its own."""
    assert hold_out_word(PLAIN) == ""


def test_the_rule_that_wins_has_the_word() -> None:
    """Oracle: the order of DataConfig's rules."""
    data = replace(PLAIN, test_every=3, test_last=2)
    assert hold_out_word(data) == "last:2"
    assert hold_out_word(replace(data, test_list=Path("n.txt"))) == "n.txt"


@pytest.mark.parametrize(
    "text",
    ["", "1", "0", "-3", "2.5", "first:", "first:0", "first:x", "frist:3", "last:2,middle:1"],
)
def test_unknown_forms_are_refused(text: str) -> None:
    """Oracle: the sentence, with all forms and the given text."""
    with pytest.raises(ConfigError, match="first:N, last:N") as error:
        parse_hold_out(text)
    assert str(error.value).endswith(f"got '{text}'")
