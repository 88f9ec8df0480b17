"""The parser of all verbs: what is wrong in a sentence, and what was probably meant."""

import argparse
import difflib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn


def sentence(text: str) -> str:
    """The text with a capital and a full stop."""
    return f"{text[0].upper()}{text[1:]}."


class Parser(argparse.ArgumentParser):
    """Says what is wrong in a sentence, without the page of usage before it."""

    def error(self, message: str) -> NoReturn:
        """End with the sentence and exit code 2."""
        sentence = message if message.endswith("?") else f"{message.rstrip('.')}."
        self.exit(2, f"{self.prog}: error: {sentence} See {self.prog} --help.\n")

    def parse_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        """As argparse does, but with the nearest option for one that there is not."""
        found, unknown = self.parse_known_args(args, namespace)
        if not unknown:
            return found
        named = [word.partition("=")[0] for word in unknown if word.startswith("--")]
        known = sorted(set(_options(self)))
        hints = [
            f"{name}: did you mean --{guess[0]}"
            for name in named
            if (guess := difflib.get_close_matches(name[2:], known, n=1, cutoff=0.7))
        ]
        self.error(
            f"{'; '.join(hints)}?" if hints else f"unrecognized arguments: {' '.join(unknown)}"
        )

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        """As argparse does, but an error of its own where a value is no value: `--x=--` ends in a
        traceback there, and an empty path means the current folder."""
        empty = action.type is Path and any(text == "" for text in arg_strings)
        if empty or (action.option_strings and arg_strings == ["--"]):
            given = "nothing" if empty else "'--'"
            raise argparse.ArgumentError(action, f"expected a value, got {given}")
        return super()._get_values(action, arg_strings)


def _options(parser: argparse.ArgumentParser) -> Iterator[str]:
    """The long names, without dashes, of the options that help shows, also of parsers below."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from _options(below)
        elif action.help != argparse.SUPPRESS:
            yield from (name[2:] for name in action.option_strings if name.startswith("--"))
