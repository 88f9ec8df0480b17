"""`gscore options`: list of all training options with values, ranges and descriptions."""

import argparse
import sys
from collections.abc import Iterator
from functools import partial
from itertools import groupby
from typing import Any

from ..config import DataConfig, TrainConfig
from ..config_file import to_json
from ..errors import ConfigError
from ..live_options import LiveOptions
from ..options import Option, options_of
from ..quoting import nearest, quoted
from ..sequence_options import SequenceOptions
from .args.data_options import HOLD_OUT
from .args.option_names_3dgs import ALIASES
from .args.run_options import plain, preset_values
from .args.unused_options import reason_of
from .parser import add_option
from .terminal.output import print_json
from .terminal.status import wrapped


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    option = partial(add_option, parser)
    option("word?", "word to search for in names and groups, or else in the texts")
    option("--json", "all properties as JSON")
    for one in all_options():
        flags = [one.flag, *filter(None, [ALIASES.get(one.name)])]
        added = parser.add_argument(
            *flags, help=argparse.SUPPRESS, dest="flag", action="store_const", const=one.name
        )
        vars(added)["declared"] = one


def run(args: argparse.Namespace) -> int:
    """Print the options that match."""
    every = list(all_options())
    word = args.word or args.flag
    found = every if word is None else matching(word, every)
    if args.json:
        print_json([facts(one) for one in found])
        return 0
    for group, members in groupby(found, key=lambda one: one.group):
        print(f"{group}:")
        for one in members:
            print(wrapped(f"  {described(one)}", sys.stdout))
        print()
    if word is not None and (others := mentioning(word, every, found)):
        more = f"The texts of these options mention {quoted(word)} too: {', '.join(others)}."
        print(wrapped(more, sys.stdout))
    print(
        wrapped(
            "Set an option with `--set NAME=VALUE` or its flag, as in `--set seed=3`.", sys.stdout
        )
    )
    return 0


def all_options() -> Iterator[Option]:
    """The options of `gscore train` and `gscore sequence`, group by group."""
    data, train, live, sequence = map(
        options_of, (DataConfig, TrainConfig, LiveOptions, SequenceOptions)
    )
    found = [*data.values(), HOLD_OUT, *train.values(), *live.values(), *sequence.values()]
    groups = dict.fromkeys(one.group for one in found)
    return (one for group in groups for one in found if one.group == group)


def matching(word: str, options: list[Option]) -> list[Option]:
    """The options that match a word: by name, group, or the beginning of a word in the name; if
    there are none, by text.

    Raises:
        ConfigError: no option matches.
    """
    pattern = _plain(word.lstrip("-"))
    tests = (
        lambda one: pattern in (one.name.lower(), _plain(ALIASES.get(one.name, "")[2:])),
        lambda one: pattern == _plain(one.group),
        lambda one: f"_{pattern}" in f"_{one.name}".lower(),
    )
    named = [one for test in tests for one in options if test(one)]
    if named:
        groups = list(dict.fromkeys(one.group for one in named))
        return sorted(dict.fromkeys(named), key=lambda one: groups.index(one.group))
    if text := [one for one in options if _holds(one, pattern)]:
        return text
    guess = nearest(pattern, [known for one in options for known in (one.name, one.group)])
    hint = f"did you mean {guess}?" if guess else "`gscore options` lists all."
    raise ConfigError(f"There is no option with {quoted(word)}; {hint}")


def mentioning(word: str, options: list[Option], found: list[Option]) -> list[str]:
    """Names of further options with a word in their texts; empty if the word names a group, since
    those are common words."""
    pattern = _plain(word.lstrip("-"))
    if any(pattern == _plain(one.group) for one in options):
        return []
    return [one.name for one in options if one not in found and _holds(one, pattern)]


def _holds(one: Option, pattern: str) -> bool:
    return pattern in _plain(f"{one.name} {one.group} {one.text}")


def _plain(text: str) -> str:
    return text.lower().replace("-", "_").replace(" ", "_")


def described(one: Option) -> str:
    """An option with default, range and text, on one line."""
    value = preset_values(one) or one.default_text
    facts = [f"= {value}" if value else "", f"({one.values})" if one.values else "", one.unit]
    head = " ".join(fact for fact in (one.name, *facts) if fact)
    return f"{head}: {plain(one.text)}{effect_condition(one)}"


def effect_condition(one: Option) -> str:
    """The sentence on the condition of an option's effect; empty: always effective."""
    reason = reason_of(one)
    return f" {reason[0].upper()}{reason[1:]}." if reason else ""


def facts(one: Option) -> dict[str, Any]:
    """All properties of an option as JSON values."""
    limits = one.range
    return {
        "name": one.name,
        "flag": one.flag,
        "group": one.group,
        "basic": one.basic,
        "type": one.kind.__name__.lower() if not one.choices else "choice",
        "several": one.several,
        "default": to_json(one.default),
        "presets": preset_values(one),
        "low": None if limits is None else limits.low,
        "high": None if limits is None else limits.high,
        "range": one.values,
        "unit": one.unit,
        "auto": one.auto,
        "choices": [str(choice) for choice in one.choices],
        "text": one.text,
        "idle": reason_of(one),
        "name_3dgs": ALIASES.get(one.name, ""),
    }
