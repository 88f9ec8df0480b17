"""Training options declared as Blender properties, with limits, defaults and texts from gscore."""

import re
from typing import Any

from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ..core import DataConfig, SequenceOptions, TrainConfig, options_of
from ..interface.option_labels import CHOICES, LABELS

Config = DataConfig | TrainConfig | SequenceOptions
"""Dataclasses with options."""
_LARGEST_INT = 2**31 - 1
"""Largest integer of Blender's properties."""
_STEP = 0.01
"""Distance of a limit from an excluded end of an option's range: fields show two digits."""


def declared(config: Config, name: str, label: str, **facts: Any) -> Any:
    """The Blender property of a training option.

    Args:
        config: Config whose values are the defaults.
        name: Name of the option.
        label: Its label in the panel.
        **facts: Other arguments of `bpy.props`, or overrides; `items` of choices.
    """
    LABELS[name] = label
    CHOICES.update({(name, item[0]): item[1] for item in facts.get("items", ())})
    one = options_of(type(config))[name]
    value = getattr(config, name)
    keywords = {"name": label, "description": describe(one.text, short=bool(one.choices))}
    if one.choices:
        return EnumProperty(**keywords, **{"default": str(value)} | facts)
    keywords["default"] = value
    if one.kind is bool:
        return BoolProperty(**keywords | facts)
    if one.kind is str:
        return StringProperty(**keywords | facts)
    kind = IntProperty if one.kind is int else FloatProperty
    return kind(**keywords | limits(one) | facts)


def describe(text: str, *, short: bool) -> str:
    """The first sentence of a text, in the style of Blender's tooltips; if `short`, cut at a colon
    or semicolon, because choices have their own texts."""
    first = re.split(r"\. ", text.replace("`", ""), maxsplit=1)[0].removesuffix(".")
    first = re.split("[:;]", first, maxsplit=1)[0] if short else first
    return first.replace("colour", "color")


def limits(one: Any) -> dict[str, Any]:
    """`min` and `max` of a number."""
    low, high = one.range.low, one.range.high
    ends = {"min": low + _STEP * one.range.above}
    if high is not None:
        ends["max"] = high - _STEP * one.range.below
    if one.kind is int and high is not None:
        ends["max"] = min(ends["max"], _LARGEST_INT)
    return {key: one.kind(value) for key, value in ends.items()}
