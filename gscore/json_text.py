"""JSON parsing of untrusted text: every defect is a ValueError."""

import json
from typing import Any

_MOST_DIGITS = 300
"""Digits of an integer; longer ones are infinite in float64, and Python refuses some of them."""


def parse_json(text: str | bytes) -> Any:
    """Parse JSON, with or without a byte order mark; bytes are UTF-8, UTF-16 or UTF-32.

    Integers beyond float64 become infinite, which range checks of callers refuse.

    Raises:
        ValueError: not JSON, or nested too deeply.
    """
    try:
        if isinstance(text, str):
            text = text.removeprefix("\ufeff")
        return json.loads(text, parse_int=_whole)
    except RecursionError:
        raise ValueError("too many nested brackets") from None


def _whole(digits: str) -> int | float:
    return int(digits) if len(digits) <= _MOST_DIGITS else float(digits)
