"""Config file: the options of a run as JSON (config.json), and differences between two runs."""

import json
import math
from collections.abc import Callable, Collection
from dataclasses import fields, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, TypeVar, cast, get_args, get_type_hints

from ._version import __version__
from .config import DataConfig, Switch, TrainConfig
from .errors import ConfigError
from .json_text import parse_json
from .options import options_of
from .quoting import brief, nearest, quoted

ConfigT = TypeVar("ConfigT", DataConfig, TrainConfig)
AnyT = TypeVar("AnyT")
REMOVED: dict[str, tuple[Any, str]] = {
    "coarse_by_detail": (False, "photos become larger at times that do not depend on their detail"),
    "reg_final": (1.0, "the penalties of mcmc keep their weight to the end of a training"),
    "grow_scale": (0.01, "splats above 0.01 extents are split"),
    "pose_start": (0.1, "pose refinement starts after a tenth of the run"),
    "pose_stop": (0.8, "pose refinement ends after four fifths of the run"),
}
"""Removed options, without effect: the value of today, and its meaning as a sentence part."""


def to_dict(config: DataConfig | TrainConfig) -> dict[str, Any]:
    """The options as JSON values: paths and enums as strings, tuples as lists."""
    return {f.name: to_json(getattr(config, f.name)) for f in fields(config)}


def from_dict(
    cls: type[AnyT], data: Any, *, where: str, warn: Callable[[str], None] = lambda text: None
) -> AnyT:
    """The config that `to_dict` wrote; options that are missing keep their defaults.

    Args:
        cls: DataConfig or TrainConfig, or another dataclass with fields of such types.
        data: The parsed JSON.
        where: Name of the file and section, for messages.
        warn: Called with a sentence for each removed option with another value than today's.

    Raises:
        ConfigError: an unknown option, or a value of another type or out of range.
    """
    if not isinstance(data, dict):
        raise ConfigError(f"{where}: expected an object with options, got {type(data).__name__}.")
    hints = get_type_hints(cls)
    values = {}
    for name, value in data.items():
        if cls is TrainConfig and name in REMOVED:
            usual, meaning = REMOVED[name]
            if value != usual:
                warn(f"{where}: {name} {quoted(value)} has no effect: {meaning}.")
            continue
        if name not in hints:
            guess = nearest(name, list(hints))
            hint = f" Did you mean {quoted(guess)}?" if guess else ""
            raise ConfigError(f"{where}: there is no option {quoted(name)}.{hint}")
        one = options_of(cls).get(name)
        auto = one is not None and one.is_auto(value)
        values[name] = value if auto else _from_json(value, hints[name], f"{where}: {name}")
    try:
        return cast("Any", cls)(**values)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from None
    except TypeError:
        raise ConfigError(f"{where}: the option 'source' is missing.") from None


def config_json(data: DataConfig, train: TrainConfig) -> str:
    """Both configs as the text of a config.json for `load_config`, with absolute paths."""
    content = {
        "gscore": __version__,
        "data": to_dict(_absolute(data)),
        "train": to_dict(_absolute(train)),
    }
    return json.dumps(content, indent=2) + "\n"


def load_config(
    path: Path, *, warn: Callable[[str], None] = lambda text: None
) -> tuple[DataConfig, TrainConfig]:
    """Read the config.json of a run, or one written by hand; `warn` as in `from_dict`.

    Raises:
        ConfigError: no such file, not JSON, an unknown option or an invalid value.
    """
    name = brief(path)
    try:
        if path.exists() and not path.is_file():  # opening a named pipe would wait for its writer
            raise ConfigError(f"{name}: expected a config file, but this is not a regular file.")
        content = parse_json(path.read_bytes())
    except FileNotFoundError:
        raise ConfigError(f"{name}: there is no such config file.") from None
    except OSError as error:
        raise ConfigError(f"{name}: cannot be read ({error.strerror or error}).") from None
    except ValueError as error:
        raise ConfigError(f"{name}: not a JSON config file ({error}).") from None
    if not isinstance(content, dict) or not {"data", "train"} <= content.keys():
        raise ConfigError(f"{name}: expected an object with 'data' and 'train', as in a run.")
    return (
        from_dict(DataConfig, content["data"], where=f"{path}: data"),
        from_dict(TrainConfig, content["train"], where=f"{path}: train", warn=warn),
    )


def differences(old: Any, new: Any, *, ignore: Collection[str] = ()) -> list[str]:
    """Sentences like "max_splats was 100, is 200", one for each option that differs."""
    return [
        f"{f.name} was {_shown(getattr(old, f.name))}, is {_shown(getattr(new, f.name))}"
        for f in fields(old)
        if f.name not in ignore and getattr(old, f.name) != getattr(new, f.name)
    ]


def _shown(value: Any) -> Any:
    if value in ("", "missing"):  # without quotes these would read like a missing value
        return quoted(str(value))
    return f"{value:g}" if isinstance(value, float) else to_json(value)


def _absolute(config: ConfigT) -> ConfigT:
    """The config with absolute paths."""
    values = {f.name: getattr(config, f.name) for f in fields(config)}
    paths = {name: value.absolute() for name, value in values.items() if isinstance(value, Path)}
    return replace(config, **paths)


def to_json(value: Any) -> Any:
    """The value of an option as JSON: paths and enums as strings, tuples as lists."""
    if isinstance(value, Path):
        return value.as_posix()
    if isinstance(value, StrEnum):
        return value.value
    return [to_json(item) for item in value] if isinstance(value, tuple) else value


def _from_json(value: Any, kind: Any, where: str) -> Any:
    """`value` as the annotated type `kind`, or ConfigError."""
    options = get_args(kind)
    if kind is Switch and isinstance(value, bool):  # some switches had no `auto` before
        return Switch.ON if value else Switch.OFF
    if type(None) in options:
        return None if value is None else _from_json(value, options[0], where)
    if options and isinstance(value, list):  # tuple[int, ...]
        return tuple(_from_json(item, options[0], where) for item in value)
    if kind is Path and isinstance(value, str):
        return Path(value)
    if isinstance(kind, type) and issubclass(kind, StrEnum):
        try:
            return kind(value)
        except ValueError:
            raise ConfigError(
                f"{where} must be one of {', '.join(kind)}, got {quoted(value)}."
            ) from None
    if kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            return math.inf if value > 0 else -math.inf  # refused by the range checks
    if kind in (int, bool, str) and type(value) is kind:
        return value
    name = "list of numbers" if options else getattr(kind, "__name__", str(kind)).lower()
    article = "an" if kind is int else "a"
    raise ConfigError(f"{where} must be {article} {name}, got {quoted(value)}.")
