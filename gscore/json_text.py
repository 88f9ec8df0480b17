"""JSON parsing of untrusted text: every defect is a ValueError."""

import json
from typing import Any

_MOST_DIGITS = 300
"""Of a whole number; longer ones are infinite for float64, and Python refuses some of them."""


def parse_json(text: str | bytes) -> Any:
    """The value that `text` holds, with or without a byte order mark; bytes are UTF-8, UTF-16 or
    UTF-32.

    Whole numbers that no float can hold become infinite, which whoever checks a range finds out.

    Raises:
        ValueError: it is no JSON, or buried in more brackets than memory is there for.
    """
    try:
        if isinstance(text, str):
            text = text.removeprefix("\ufeff")
        return json.loads(text, parse_int=_whole)
    except RecursionError:
        raise ValueError("too many brackets in each other") from None


def _whole(digits: str) -> int | float:
    return int(digits) if len(digits) <= _MOST_DIGITS else float(digits)
