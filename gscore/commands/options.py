"""`gscore options`: all options of a training, with their values, ranges and what they do."""

import argparse
import sys
from collections.abc import Iterator
from itertools import groupby
from typing import Any

from ..config import DataConfig, TrainConfig
from ..config_file import to_json
from ..errors import ConfigError
from ..live_options import LiveOptions
from ..options import Option, options_of
from ..sequence_options import SequenceOptions
from ..shown import quoted
from .given.data_options import HOLD_OUT
from .given.declared import plain, preset_values
from .given.names_3dgs import ALIASES
from .given.no_effect import reason_of
from .parser import nearest
from .terminal.output import print_json
from .terminal.status import wrapped


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    parser.add_argument(
        "word", nargs="?", help="those of this name or group, else with this in their name or text"
    )
    parser.add_argument("--json", action="store_true", help="as JSON, with all that is known")


def run(args: argparse.Namespace) -> int:
    """Print the options that were asked for."""
    found = list(all_options())
    if args.word is not None:
        found = matching(args.word, found)
    if args.json:
        print_json([facts(one) for one in found])
        return 0
    for group, members in groupby(found, key=lambda one: one.group):
        print(f"{group}:")
        for one in members:
            print(wrapped(f"  {described(one)}", sys.stdout))
        print()
    print(
        wrapped("Give one as --set NAME=VALUE or under its flag, as in --set seed=3.", sys.stdout)
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
    """The options that a word asks for.

    Raises:
        ConfigError: there is none.
    """
    wanted = word.lower().lstrip("-").replace("-", "_")
    tests = (
        lambda one: wanted == one.name.lower(),
        lambda one: wanted == one.group.replace(" ", "_"),
        lambda one: wanted in f"{one.name} {one.group} {one.text}".lower().replace("-", "_"),
    )
    for test in tests:
        if found := [one for one in options if test(one)]:
            return found
    guess = nearest(wanted, [known for one in options for known in (one.name, one.group)])
    hint = f"did you mean {guess}?" if guess else "`gscore options` lists all."
    raise ConfigError(f"There is no option with {quoted(word)}; {hint}")


def described(one: Option) -> str:
    """All on an option, on one line."""
    value = preset_values(one) or one.default_words
    facts = [f"= {value}" if value else "", f"({one.values})" if one.values else "", one.unit]
    head = " ".join(fact for fact in (one.name, *facts) if fact)
    return f"{head}: {plain(one.text)}{idle_when(one)}"


def idle_when(one: Option) -> str:
    """A sentence on when an option does nothing; empty where there is no such case."""
    reason = reason_of(one)
    return f" Can be without effect ({reason})." if reason else ""


def facts(one: Option) -> dict[str, Any]:
    """All on an option as JSON values."""
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
        "choices": [str(choice) for choice in one.choices],
        "text": one.text,
        "idle": reason_of(one),
        "name_3dgs": ALIASES.get(one.name, ""),
    }
