"""Changes of a training config by name, for benches: a strategy, a disabled skip, an option."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from ...config import LIFTED_BY, Skip, Strategy, TrainConfig
from ...config_file import from_dict, to_dict
from ...errors import ConfigError
from ...json_text import parse_json
from ...quoting import quoted
from ...trainer.files.checkpoint import FREE

_NOT_HERE = ("seed", "start_opacity", *sorted(FREE - {"iterations", *LIFTED_BY.values()}))
"""Options that benches set themselves, or that do not affect a training from points."""


def changed(config: TrainConfig, changes: Sequence[str], *, flag: str) -> TrainConfig:
    """`config` with all these changes.

    Args:
        config: Options to change.
        changes: Each a strategy, a skip to disable, or OPTION=VALUE.
        flag: The command-line option with the changes, for messages.

    Raises:
        ConfigError: there is no such change, or the value is invalid.
    """
    for name in changes:
        config = _changed(config, name, flag)
    return config


def _changed(config: TrainConfig, name: str, flag: str) -> TrainConfig:
    if name in tuple(Strategy):
        return replace(config, strategy=Strategy(name))
    if name in tuple(Skip):
        return replace(config, without=(*config.without, Skip(name)))
    option, equals, value = name.partition("=")
    option = option.replace("-", "_")
    if not equals or option in _NOT_HERE or option.startswith("depth_"):
        known = ", ".join((*Strategy, *Skip))
        raise ConfigError(
            f"There is no change {quoted(name)} for {flag}; there are: {known}, and OPTION=VALUE "
            "for options of gscore.TrainConfig that affect a training without depth maps."
        )
    values = to_dict(config) | {option: _value(value, getattr(config, option, None))}
    if option in LIFTED_BY:  # as for `gscore train`
        values[LIFTED_BY[option]] = 0
    return from_dict(TrainConfig, values, where=f"{flag} {name}")


def _value(text: str, now: Any) -> Any:
    """The value of `text` for an option with the value `now`."""
    if isinstance(now, bool) and text in ("on", "off"):
        return text == "on"
    try:
        return parse_json(text)
    except ValueError:
        return text
