"""Argument parser of all verbs: errors in one sentence, with suggestions for misspelt names."""

import argparse
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

from ..config import checked_threads
from ..errors import ConfigError
from ..quoting import brief, nearest, quoted
from .terminal.status import wrapped

_REQUIRED = "the following arguments are required: "
"""Prefix of argparse's message; the names of an argument follow, separated by slashes."""
_NEGATIVE = re.compile(r"-\.?\d")
"""Beginning of a negative number."""
_EXPECTED = re.compile(r"expected ((?:at least |at most )?(?:one|\d+)) argument")
"""Argparse's message on a missing value."""
_NUMBERS = {"int": "a whole number", "float": "a number"}
"""Types of numbers in messages."""
_MEANT = {
    **dict.fromkeys(("fast", "fastest", "quick", "test", "tiny"), "preview"),
    **dict.fromkeys(("low", "rough"), "draft"),
    **dict.fromkeys(("default", "medium", "mid", "standard"), "normal"),
    **dict.fromkeys(("best", "full", "quality", "slow", "ultra"), "high"),
}
"""Choices by their names in other programs."""


def sentence(text: str) -> str:
    """The text as a sentence, capitalised and with a full stop."""
    return f"{text[0].upper()}{text[1:]}."


def add_option(
    group: argparse._ActionsContainer,
    usage: str,
    text: str | None = None,
    kind: Callable[[str], Any] | None = None,
    unless: Sequence[str] = (),
    **facts: Any,
) -> None:
    """Declare an option or argument by its usage, as in a help page.

    Args:
        group: A parser, or a group of one.
        usage: The names, then those of the values: `-o, --output FILE`, `source`. `...` at the end
            takes one or more values, `*` any number, `?` at most one. An option without values
            and choices is a switch.
        text: The help.
        kind: Converts a value; else the type of a numeric default.
        unless: Options in whose absence an argument with `?` is needed, so that errors name it.
        facts: Further arguments of argparse's `add_argument`.
    """
    words = usage.removesuffix("...").rstrip("*?").split()
    names = [word.rstrip(",") for word in words if word.startswith("-")] or words[:1]
    values = words[len(names) :]
    if usage[-1] in ".*?":
        facts["nargs"] = "+" if usage[-1] == "." else usage[-1]
    elif len(values) > 1:
        facts["nargs"] = len(values)
    if values:
        facts["metavar"] = values[0] if len(values) == 1 else tuple(values)
    elif usage.startswith("-") and not (kind or facts.keys() & {"action", "choices", "default"}):
        facts["action"] = "store_true"
    if kind or isinstance(facts.get("default"), int | float):
        facts["type"] = kind or type(facts["default"])
    vars(group.add_argument(*names, help=text, **facts))["unless"] = unless


def add_threads_option(parser: argparse.ArgumentParser) -> None:
    """Declare `--threads`, for verbs without training options."""
    add_option(parser, "--threads N", "CPU threads; auto: all cores (auto)", _threads, default=0)


def add_result_options(parser: argparse.ArgumentParser, *, replaced: str = "") -> None:
    """Declare `--json`, `--quiet`, and `--overwrite` if the verb replaces files: which ones."""
    if replaced:
        add_option(parser, "--overwrite", f"replace {replaced} that gscore did not write")
    add_option(parser, "--json", "the result as JSON on stdout")
    add_option(parser, "--quiet", "no progress")


def _threads(text: str) -> int:
    try:
        return 0 if text == "auto" else checked_threads(int(text))
    except ValueError as error:  # ConfigError is one
        words = str(error) if isinstance(error, ConfigError) else f"{text!r} is not a whole number"
        raise argparse.ArgumentTypeError(words) from None


class UsageExit(SystemExit):
    """Exit with code 2 after an invalid argument was reported."""

    def __init__(self, sentence: str) -> None:
        super().__init__(2)
        self.sentence = sentence


class Parser(argparse.ArgumentParser):
    """Parser whose errors are one sentence, without the usage page."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Create an argparse parser that reads -1e-3 as a number in every Python version."""
        super().__init__(*args, **kwargs)
        self._negative_number_matcher = _NEGATIVE
        self._found = argparse.Namespace()

    def error(self, message: str) -> NoReturn:
        """Print the message and raise `UsageExit`."""
        if message.startswith(_REQUIRED):
            names = [*self._needed(), *message.removeprefix(_REQUIRED).split(", ")]
            message = f"missing: {', '.join(name.split('/')[0] for name in names)}"
            message += "".join(
                f", one of {', '.join(action.choices)}"
                for action in self._actions
                if isinstance(action, argparse._SubParsersAction) and action.metavar in names
            )
        message = _EXPECTED.sub(r"expected \1 value", message)
        sentence = message if message.endswith("?") else f"{message.rstrip('.')}."
        sentence = f"{sentence} See {self.prog} --help."
        print(wrapped(f"{self.prog}: error: {sentence}", sys.stderr), file=sys.stderr)
        raise UsageExit(sentence)

    def _needed(self) -> list[str]:
        """Names of the absent arguments that the given options do not replace."""
        found = vars(self._found)
        return [
            action.dest
            for action in self._actions
            if (unless := vars(action).get("unless"))
            and not any(map(found.get, (action.dest, *unless)))
        ]

    def format_help(self) -> str:
        """The help, with only the required arguments in the usage line."""
        whole, self.usage = self.usage, self._short_usage()
        try:
            return super().format_help()
        finally:
            self.usage = whole

    def _short_usage(self) -> str:
        required, places = [], []
        for action in self._actions:
            name = str(action.metavar or action.dest)
            if isinstance(action, argparse._SubParsersAction):
                places.append(f"{name} ...")
            elif not action.option_strings and action.help != argparse.SUPPRESS:
                places.append(f"[{name}]" if action.nargs == "?" else name)
            elif action.required:
                required.append(f"{action.option_strings[0]} {name.upper()}")
        return " ".join(["%(prog)s", *places, *required, "[options]"])

    def parse_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Parse arguments; the error for an unknown option suggests the nearest one."""
        words = sys.argv[1:] if args is None else list(args)
        self._check_output(words)
        self._check_names(words)
        self._found = namespace or argparse.Namespace()  # of use to `error` too
        found, unknown = self.parse_known_args(words, self._found)
        if unknown:
            self.error(f"unrecognized arguments: {brief(' '.join(unknown))}")
        return found

    def _check_output(self, words: Sequence[str]) -> None:
        """Refuse -o and --output where the output is an argument."""
        places = [action for action in self._actions if not action.option_strings]
        named = [word for word in words if word.partition("=")[0] in ("-o", "--output")]
        if named and "output" in [action.dest for action in places]:
            usage = " ".join(str(action.metavar or action.dest) for action in places)
            self.error(f"the output is an argument, without {named[0]}: {self.prog} {usage}")

    def _check_names(self, words: Sequence[str]) -> None:
        """Report unknown long options before any other error."""
        known = set(_options(self, hidden=True))
        before_dashes = words[: list(words).index("--")] if "--" in words else words
        named = [word.partition("=")[0] for word in before_dashes if word.startswith("--")]
        unknown = [name for name in named if name[2:] not in known]
        if not unknown:
            return
        offered = sorted(set(_options(self)))
        hints = [
            f"{brief(name)}: did you mean --{guess}"
            for name in unknown
            if (guess := nearest(name[2:], offered))
        ]
        missing = f"there is no option {brief(', '.join(unknown))}"
        self.error(f"{'; '.join(hints)}?" if hints else missing)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse a value outside the choices and suggest the likely one."""
        if action.choices is None or value in action.choices:
            return
        choices = [str(choice) for choice in action.choices]
        meant = _MEANT.get(str(value))
        guess = meant if meant in choices else nearest(str(value), choices)
        hint = f"did you mean {guess}? There are" if guess else "there are"
        raise argparse.ArgumentError(
            action, f"there is no {quoted(value)}; {hint}: {', '.join(choices)}"
        )

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        """Return the values of an action, with an error for missing ones: in argparse `--x=--`
        raises a traceback, and an empty path is the current folder."""
        empty = action.type is Path and any(text == "" for text in arg_strings)
        if empty or (action.option_strings and arg_strings == ["--"]):
            given = "nothing" if empty else "'--'"
            raise argparse.ArgumentError(action, f"expected a value, got {given}")
        return super()._get_values(action, arg_strings)

    def _get_value(self, action: argparse.Action, arg_string: str) -> Any:
        """Return a converted value; the error message shortens long ones."""
        try:
            return super()._get_value(action, arg_string)
        except argparse.ArgumentError as error:
            words = error.message.replace(repr(arg_string), quoted(arg_string))
            if kind := _NUMBERS.get(getattr(action.type, "__name__", "")):
                words = f"expected {kind}, got {quoted(arg_string)}"
            raise argparse.ArgumentError(action, words) from error


def _options(parser: argparse.ArgumentParser, *, hidden: bool = False) -> Iterator[str]:
    """Long names, without dashes, of the options in the help and of all training options,
    including subparsers; with `hidden`, of all options."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from _options(below, hidden=hidden)
        elif hidden or action.help != argparse.SUPPRESS or "declared" in vars(action):
            yield from (name[2:] for name in action.option_strings if name.startswith("--"))
