"""Numbers that benches are given, checked before anything is measured."""

import argparse
from collections.abc import Sequence

from ...config import flag_of
from ...errors import ConfigError


def check_numbers(args: argparse.Namespace, least: int, *names: str) -> None:
    """Raise ConfigError where an option, or one of its numbers, is less than `least`."""
    for name in names:
        value = getattr(args, name)
        for number in value if isinstance(value, Sequence) else [value]:
            if number < least:
                raise ConfigError(f"{flag_of(name)} must be at least {least}, got {number}.")
