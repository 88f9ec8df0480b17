"""Hold-out option: `--hold-out`, which selects the held-out views."""

import re
from pathlib import Path
from typing import Any

from .config import DataConfig
from .errors import ConfigError
from .quoting import quoted

SPLIT = ("test_every", "test_list", "test_first", "test_last")
"""The fields of DataConfig that it sets."""
FORMS = "a number N of at least 2 (every N-th), first:N, last:N, first:N,last:N, or a text file"
_END = re.compile(r"([A-Za-z]{2,}):(.*)")
"""A single letter would be a Windows drive."""


def parse_hold_out(text: str) -> dict[str, Any]:
    """The values of `SPLIT` for a text of `FORMS`; the others have their defaults.

    Raises:
        ConfigError: the text has none of the forms.
    """
    plain = DataConfig(source=Path())
    values = {name: getattr(plain, name) for name in SPLIT}
    if re.fullmatch(r"[-+]?[\d.]+", text):
        return values | {"test_every": _count(text, text, least=2)}
    ends = [_END.fullmatch(part) for part in text.split(",")]
    if not text or (any(ends) and not all(end and end[1] in ("first", "last") for end in ends)):
        raise ConfigError(f"expected {FORMS}, got {quoted(text)}")
    named = [end for end in ends if end]
    if not named:
        return values | {"test_list": Path(text)}
    for end in named:
        values[f"test_{end[1]}"] = _count(end[2], text, least=1)
    return values


def hold_out_word(data: DataConfig) -> str:
    """The `--hold-out` value of the rule that applies in `data`; empty: the default rule."""
    if data.test_list is not None:
        listed = str(data.test_list)
        try:
            is_path = parse_hold_out(listed)["test_list"] is not None
        except ConfigError:
            is_path = False
        return listed if is_path else f"./{listed}"
    ends = {"first": data.test_first, "last": data.test_last}
    if any(ends.values()):
        return ",".join(f"{name}:{count}" for name, count in ends.items() if count)
    default = DataConfig(source=data.source).test_every
    return "" if data.test_every == default else str(data.test_every)


def _count(digits: str, text: str, *, least: int) -> int:
    if not re.fullmatch(r"\d{1,9}", digits) or int(digits) < least:
        raise ConfigError(f"expected {FORMS}, got {quoted(text)}")
    return int(digits)
