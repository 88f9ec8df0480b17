"""Every option of every verb with invalid values; oracle: a sentence naming the option."""

import argparse
from collections.abc import Iterator
from importlib import import_module

import pytest

from gscore.commands import VERBS, main
from gscore.commands.parser import Parser


def parsers(verb: str) -> Iterator[tuple[list[str], argparse.ArgumentParser]]:
    """Each parser of a verb, with the words before its options."""
    parser = Parser(prog="gscore", allow_abbrev=False)
    import_module(f"gscore.commands.{verb}").add_arguments(parser)
    below = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    if not below:
        yield [verb], parser
    for name, one in below[0].choices.items() if below else ():
        yield [verb, name], one


def forms(action: argparse.Action, value: str) -> Iterator[list[str]]:
    """Ways to give an option a value."""
    for name in action.option_strings:
        yield [f"{name}={value}"]
        yield [name, value]
        if not name.startswith("--"):
            yield [name + value]


@pytest.mark.parametrize("verb", list(VERBS))
@pytest.mark.parametrize("value", ["--", "-", "", "=", "-1", "nan"])
def test_any_value_is_taken_or_refused_in_one_line(
    verb: str, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: argparse's own end with code 2; `--` is refused by name in place of a value."""
    seen = 0
    for _, parser in parsers(verb):
        for action in parser._actions:
            for form in forms(action, value):
                seen += 1
                capsys.readouterr()
                try:
                    parser.parse_args(form)
                except SystemExit as stop:
                    assert stop.code in (0, 2)
                    assert capsys.readouterr().err.count("\n") <= 1
    assert seen


@pytest.mark.parametrize("verb", list(VERBS))
def test_two_dashes_and_nothing_are_no_values(
    verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: through the whole command line, for all options that take one value; an empty path,
    as from an unset shell variable, is not the current folder."""
    for words, parser in parsers(verb):
        for action in parser._actions:
            name = max(action.option_strings, key=len, default="")
            if not name or action.nargs is not None:
                continue
            assert main([*words, f"{name}=--"]) == 2
            err = capsys.readouterr().err
            assert name in err
            assert "expected a value, got '--'." in err
            assert main([*words, name]) == 2
            assert "Traceback" not in capsys.readouterr().err
            if getattr(action.type, "__name__", "") == "Path":
                assert main([*words, f"{name}="]) == 2
                assert "expected a value, got nothing." in capsys.readouterr().err


def test_the_sentence_names_the_option(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: the words."""
    assert main(["train", "x", "-o", "y", "--iterations=--"]) == 2
    err = capsys.readouterr().err
    assert err.startswith("gscore train: error: argument --iterations: expected a value, got '--'.")
    assert main(["train", "", "-o", "y"]) == 2
    assert "argument source: expected a value, got nothing." in capsys.readouterr().err
