"""Option declarations: metadata of config fields, used by help, checks and panels."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from functools import cache
from types import MappingProxyType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from .errors import ConfigError
from .quoting import quoted

LARGEST = 1e9
"""Limit of numbers other than counts: products of several must fit float32."""
_KEY = "option"

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Range:
    """Allowed numbers of an option, bounds included by default."""

    low: float = 0
    high: float | None = None
    """Highest value; None: no upper bound."""
    above: bool = False
    """`low` itself is excluded."""
    below: bool = False
    """`high` itself is excluded."""
    also: float | None = None
    """A number outside the range with a special meaning."""

    def __contains__(self, value: float) -> bool:
        if value == self.also:
            return True
        enough = self.low < value if self.above else self.low <= value  # False for NaN
        if self.high is None:
            return enough
        return enough and (value < self.high if self.below else value <= self.high)

    def __str__(self) -> str:
        low, high = _digits(self.low), None if self.high is None else _digits(self.high)
        if high is None:
            words = f"more than {low}" if self.above else f"at least {low}"
        elif self.above:
            words = f"more than {low}, {'less than' if self.below else 'at most'} {high}"
        else:
            words = f"{low} to less than {high}" if self.below else f"{low} to {high}"
        return words if self.also is None else f"{words}, or {_digits(self.also)}"


@dataclass(frozen=True, kw_only=True)
class Option:
    """Declaration of one option."""

    name: str = ""
    default: Any
    kind: type
    """bool, int, float, str, Path or a StrEnum; type of the members if `several`."""
    several: bool = False
    """The value is a tuple."""
    text: str
    """Help text; `--help` shows its first sentence only."""
    group: str
    """Heading in the option list."""
    range: Range | None = None
    """Allowed numbers; by default at least 0, of a float also at most `LARGEST`."""
    unit: str = ""
    auto: float | None = None
    """Number that stands for a value selected automatically; also read as `auto` or None."""
    choices: tuple[str, ...] = ()
    """Allowed values; empty: any of this kind."""
    metavar: str = ""
    """Placeholder of the value in `--help`; empty: by unit and kind."""
    short: str = ""
    """One-letter flag."""
    basic: bool = False
    """Shown by `--help`; the others are listed by `gscore options`."""
    when: str = ""
    """Condition of its effect, a key in `commands.args.unused_options`; empty: always."""
    free: bool = False
    """True if the value may change when a run is resumed."""

    @property
    def flag(self) -> str:
        """Long flag on the command line."""
        return "--" + self.name.replace("_", "-")

    @property
    def values(self) -> str:
        """Description of the allowed values; empty: any of this kind."""
        if self.choices:
            return ", ".join(self.choices)
        if self.kind is bool:
            return "on, off"
        if self.auto is None or self.range is None:
            return str(self.range or "")
        numbers = replace(self.range, also=None) if self.range.also == self.auto else self.range
        return f"auto, or {numbers}"

    @property
    def default_text(self) -> str:
        """Default as command-line text; empty: none."""
        automatic = self.auto is not None and self.default == self.auto
        return "auto" if automatic else value_text(self.default)

    def is_auto(self, value: Any) -> bool:
        """Whether a value is None or `auto`, and the option has a number for them."""
        return self.auto is not None and (value is None or value == "auto")


def option(default: T, text: str, **facts: Any) -> T:
    """Declare a config field as an option of a run.

    Args:
        default: Default value.
        text: Help text.
        **facts: Other fields of `Option` that the type annotation does not imply.
    """
    declared: Any = field(default=default, metadata={_KEY: {"text": text} | facts})
    return declared


@cache
def options_of(cls: type[Any]) -> Mapping[str, Option]:
    """The options of a config class by name, in the order of declaration."""
    hints = get_type_hints(cls)
    result = {}
    for one in fields(cls):
        if _KEY in one.metadata:
            known = _of_type(hints[one.name]) | {"name": one.name, "default": one.default}
            result[one.name] = Option(**(known | one.metadata[_KEY]))
    return MappingProxyType(result)


def check_options(config: Any) -> None:
    """Raise ConfigError for the first invalid value of a config."""
    for name, declared in options_of(type(config)).items():
        value = getattr(config, name)
        if declared.is_auto(value):
            value = declared.kind(declared.auto)
            object.__setattr__(config, name, value)
        members = value if declared.several else (value,)
        if any(not _is_allowed(declared, member) for member in members):
            each = f"each of {name}" if declared.several else name
            raise ConfigError(f"{each} must be {_expected(declared)}, got {quoted(value)}.")


def value_text(value: Any) -> str:
    """A value as command-line text; empty for none."""
    if isinstance(value, tuple):
        return " ".join(value_text(member) for member in value)
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, int | float):
        return _digits(value)
    return "" if value is None else str(value)


def _is_allowed(declared: Option, value: Any) -> bool:
    if declared.choices:
        return value in declared.choices
    return declared.range is None or value is None or value in declared.range


def flag_of(name: str) -> str:
    """Name of an option on the command line."""
    return {"resolution": "-r"}.get(name, "--" + name.replace("_", "-"))


def _expected(declared: Option) -> str:
    return f"one of {declared.values}" if declared.choices else declared.values


def _of_type(hint: Any) -> dict[str, Any]:
    """Option attributes from the annotation of a field."""
    inner = [kind for kind in get_args(hint) if kind not in (type(None), ...)]
    kind = inner[0] if inner else hint
    facts: dict[str, Any] = {"kind": kind, "several": get_origin(hint) is tuple}
    if issubclass(kind, StrEnum):
        facts["choices"] = tuple(kind)
    elif kind is float:
        facts["range"] = Range(high=LARGEST)
    elif kind is int:
        facts["range"] = Range()
    return facts


def _digits(number: float) -> str:
    """A number as short text, with all digits of integers."""
    return str(number) if isinstance(number, int) else f"{number:g}"
