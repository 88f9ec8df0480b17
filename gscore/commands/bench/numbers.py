"""Numbers in the arguments of benches, checked before the first measurement."""

import argparse
from collections.abc import Sequence

from ...errors import ConfigError
from ...option_marks import mark_option
from ...quoting import brief, quoted
from ...text_format import number

_MOST = 10**8
"""Ten times the splats of a large scene; they need 24 GB."""


def check_numbers(args: argparse.Namespace, least: int, *names: str) -> None:
    """Raise ConfigError if a number of an option is less than `least` or absurdly large."""
    for name in names:
        value = getattr(args, name)
        for given in value if isinstance(value, Sequence) else [value]:
            if given < least:
                raise ConfigError(
                    f"{mark_option(name)} must be at least {least}, got {quoted(given)}."
                )
            if given > _MOST:
                raise ConfigError(
                    f"{mark_option(name)} must be at most {number(_MOST)}, got {brief(given)}."
                )
