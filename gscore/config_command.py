"""Config as a command line: a preset plus the options that differ from it; depth commands."""

import shlex
from collections.abc import Iterator, Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

from .config import LIFTED_BY, DataConfig, TrainConfig, unlimited
from .hold_out import SPLIT, hold_out_word
from .options import flag_of
from .presets import RECIPES, on_card, on_cpu

_OF_THE_SPLIT = ("eval", "test_offset", *SPLIT)
_OF_A_PRESET = ("iterations", "max_splats", "sh_degree")


def preset_of(data: DataConfig, train: TrainConfig) -> str:
    """The preset with this width limit of photos, of several the one with the fewest other options;
    empty: none, and no option sets such a limit."""
    return _nearest(data, train)[0]


def _nearest(data: DataConfig, train: TrainConfig) -> tuple[str, DataConfig, TrainConfig]:
    """`preset_of` and its options, those of the CPU or, unless that is named, of a card."""
    recipes = (on_cpu,) if train.device == "cpu" else (on_cpu, on_card)
    made = [(name, *of(name, data.source)) for of in recipes for name in RECIPES]
    alike = [one for one in made if one[1].max_width == data.max_width]
    changes = [len(list(_differences(one[2], train))) for one in alike]
    return alike[changes.index(min(changes))] if alike else ("", data, train)


def preset_text(data: DataConfig, train: TrainConfig) -> str:
    """Name of the preset, and whether options were changed; empty: no preset."""
    name, _, plain = _nearest(data, train)
    if not name:
        return ""
    for option, limit in LIFTED_BY.items():
        value = getattr(train, option)
        if value < getattr(plain, option) and getattr(train, limit):  # lowered by the limit
            plain = replace(plain, **{option: value})
    changed = any(getattr(plain, option) != getattr(train, option) for option in _OF_A_PRESET)
    return f"preset {name}, changed" if changed else f"preset {name}"


def train_command(
    data: DataConfig,
    train: TrainConfig,
    output: Path,
    *,
    requested: Mapping[str, int] | None = None,
) -> str:
    """The `gscore train` command with these options, for a shell; empty if there is none.

    Args:
        data, train: The options.
        output: Folder for the results.
        requested: Requested value of each option that the photos limited. The same photos limit it
            again, so the command omits it.
    """
    preset, plain_data, plain_train = _nearest(data, train)
    if not preset or (data.eval and data.test_offset is not None):
        return ""
    words = ["gscore", "train", str(data.source), "-o", str(output), "--preset", preset]
    words += _split(data)
    for name, value in _differences(plain_data, data):
        if name not in _OF_THE_SPLIT:
            words += _option(name, value)
    for name, value in _given(plain_train, unlimited(train, requested or {})).items():
        words += _option(name, value)
    return shlex.join(words)


def _given(plain: TrainConfig, train: TrainConfig) -> dict[str, Any]:
    """Options to add to a preset to obtain `train`, by name."""
    given = dict(_differences(plain, train))
    if train.time_budget:
        given.pop("iterations", None)  # a time budget determines the steps
    for name, limit in LIFTED_BY.items():
        if name == "iterations" and train.time_budget:
            continue
        before, now = getattr(plain, limit), getattr(train, limit)
        if before and not now:  # giving the option lifts the limit, even with the preset's value
            del given[limit]
            given[name] = getattr(train, name)
        elif name in given and now:
            given[limit] = now  # else giving the option would lift the limit
    return given


def depth_command(data: DataConfig) -> str:
    """The `gscore depth` command for these views, for a shell, without the method. Empty if no
    command has their split."""
    if data.eval and data.test_offset is not None:
        return ""
    words = ["gscore", "depth", str(data.source)]
    if data.eval:  # the verb has no --eval; its value 8 keeps the split of the capture
        words += ["--hold-out", hold_out_word(data) or str(data.test_every)]
    return shlex.join(words)


def _differences(
    plain: DataConfig | TrainConfig, given: DataConfig | TrainConfig
) -> Iterator[tuple[str, Any]]:
    """Name and value of the options in which `given` differs."""
    before = asdict(plain)
    for field in fields(given):
        value = getattr(given, field.name)
        if value != before[field.name]:
            yield field.name, value


def _split(data: DataConfig) -> list[str]:
    """The option of the rule that selects the test views; a rule implies --eval."""
    if not data.eval:
        return []
    word = hold_out_word(data)
    return ["--hold-out", word] if word else ["--eval"]


def _option(name: str, value: Any) -> list[str]:
    """The arguments of one option."""
    flag = flag_of(name)
    if isinstance(value, bool):
        return [flag if value else "--no-" + flag.removeprefix("--")]
    if isinstance(value, tuple):
        return [flag, *map(str, value)]
    return [flag, str(value).removesuffix(".0")]
