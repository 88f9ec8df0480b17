"""Run options on the command line, declared by config.py: flags, help, values."""

import argparse
from collections.abc import Callable, Collection
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any

from ...config import TrainConfig
from ...options import Option, options_of, value_text
from ...presets import PRESETS
from ...quoting import nearest, quoted
from ...text_format import number

_SENTENCE_END = ". "
_ON_OR_OFF = {
    **dict.fromkeys(("on", "true", "yes", "1"), True),
    **dict.fromkeys(("off", "false", "no", "0"), False),
}

_METAVARS = {"s": "SECONDS", "dB": "DB", "MB": "MB"}
"""Placeholders of values by their unit."""


def declare(
    group: argparse._ActionsContainer, cls: type[Any], *, names: Collection[str] = ()
) -> None:
    """Declare the options of a config; those that are not basic are hidden in help.

    Args:
        group: Argument group of a parser.
        cls: DataConfig or TrainConfig.
        names: The options to declare; empty: all.
    """
    for name, one in options_of(cls).items():
        if name in names or not names:
            flags = [f"-{one.short}", one.flag] if one.short else [one.flag]
            shown = help_text(one) if one.basic else argparse.SUPPRESS
            action = group.add_argument(
                *flags, dest=name, default=None, help=shown, **argument_facts(one)
            )
            vars(action)["declared"] = one


def argument_facts(one: Option) -> dict[str, Any]:
    """Keyword arguments for argparse: type, choices and action of an option."""
    if one.kind is bool:
        return {"action": argparse.BooleanOptionalAction}
    facts: dict[str, Any] = {"nargs": "+"} if one.several else {}
    if one.kind in (int, float, Path):
        facts["type"] = one.kind if one.auto is None else _number_or_auto(one)
    if one.choices:
        facts["choices"] = one.choices
    if one.metavar or not one.choices:
        plain = _METAVARS.get(one.unit, "N" if one.kind is int else "X")
        facts["metavar"] = one.metavar or plain
    return facts


def _number_or_auto(one: Option) -> Callable[[str], Any]:
    def read(text: str) -> Any:
        return one.auto if one.is_auto(text) else one.kind(text)

    read.__name__ = one.kind.__name__  # for the error message
    return read


def passed_options(cls: type[Any], args: argparse.Namespace) -> dict[str, Any]:
    """The given options of a config by name, as field values."""
    given = {}
    for name, one in options_of(cls).items():
        value = getattr(args, name, None)
        if value is not None:
            given[name] = _as_field(one, value)
    return given


def help_text(one: Option) -> str:
    """The first sentence of an option's text with its default, for `--help`."""
    first = plain(one.text).partition(_SENTENCE_END)[0].removesuffix(".")
    if not first[1:2].isupper():  # CPU, PLY
        first = first[0].lower() + first[1:]
    shown = preset_values(one, most="high") or one.default_text
    return (f"{first} ({shown})" if shown else first).replace("%", "%%")


def preset_values(one: Option, *, most: str = "") -> str:
    """The values of an option in the presets, up to the preset `most`; empty if all are equal."""
    if one.name not in options_of(TrainConfig):
        return ""
    found = {}
    for name, train in _preset_options().items():
        found[name] = getattr(train, one.name)
        if name == most:
            break
    if len(set(found.values())) == 1:
        return ""
    return ", ".join(f"{name} {_shown(value)}" for name, value in found.items())


@cache
def _preset_options() -> dict[str, TrainConfig]:
    """Training options of the presets, made once for the help of all options."""
    return {name: make(Path())[1] for name, make in PRESETS.items()}


def _shown(value: Any) -> str:
    return number(value) if isinstance(value, int) else value_text(value)


def plain(text: str) -> str:
    """A text without backticks."""
    return text.replace("`", "")


class Set(argparse.Action):
    """`--set NAME=VALUE`: the same as the long flag of the option, hidden or not."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        name, equals, value = str(values).partition("=")
        name = name.strip().replace("-", "_")
        known = {
            one.name: action
            for action in parser._actions
            if isinstance(one := vars(action).get("declared"), Option)
        }
        if name not in known:
            guess = nearest(name, list(known))
            hint = f"did you mean {guess}?" if guess else "`gscore options` lists all"
            raise argparse.ArgumentError(self, f"there is no option {quoted(name)}; {hint}")
        if not equals or not value:
            raise argparse.ArgumentError(self, f"expected {name}=VALUE, got {quoted(values)}")
        setattr(namespace, name, self._value(parser, known[name], value))

    def _value(self, parser: argparse.ArgumentParser, action: argparse.Action, text: str) -> Any:
        one = vars(action)["declared"]
        if one.kind is not bool:
            words = text.replace(",", " ").split() if one.several else [text]
            return parser._get_values(action, words)
        if text.lower() not in _ON_OR_OFF:
            raise argparse.ArgumentError(self, f"{one.name} must be on or off, got {quoted(text)}")
        return _ON_OR_OFF[text.lower()]


def _as_field(one: Option, value: Any) -> Any:
    convert = one.kind if issubclass(one.kind, StrEnum) else (lambda member: member)
    if one.several:  # 3DGS: step -1 is never
        return tuple(convert(member) for member in value if member != -1)
    return convert(value)
