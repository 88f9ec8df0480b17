"""Training options declared as Blender properties, with limits, defaults and texts from gscore."""

import re
from typing import Any

from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ..core import DataConfig, SequenceOptions, TrainConfig, options_of
from ..interface.option_labels import CHOICES, LABELS

Config = DataConfig | TrainConfig | SequenceOptions
"""Has options."""
_LARGEST_INT = 2**31 - 1
"""Of Blender's whole numbers."""
_STEP = 0.01
"""How far a number stays from an end that its option does not take: fields show two digits."""


def declared(config: Config, name: str, label: str, **facts: Any) -> Any:
    """The Blender property of a training option.

    Args:
        config: Whose values are the defaults.
        name: Of the option.
        label: Its label in the panel.
        **facts: Other arguments of `bpy.props`, or overrides; `items` of choices.
    """
    LABELS[name] = label
    CHOICES.update({(name, item[0]): item[1] for item in facts.get("items", ())})
    one = options_of(type(config))[name]
    value = getattr(config, name)
    given = {"name": label, "description": describe(one.text, short=bool(one.choices))}
    if one.choices:
        return EnumProperty(**given, **{"default": str(value)} | facts)
    given["default"] = value
    if one.kind is bool:
        return BoolProperty(**given | facts)
    if one.kind is str:
        return StringProperty(**given | facts)
    kind = IntProperty if one.kind is int else FloatProperty
    return kind(**given | limits(one) | facts)


def describe(text: str, *, short: bool) -> str:
    """The first sentence of a text as Blender writes tips; if `short`, not what follows a colon or
    semicolon, for choices have texts of their own."""
    first = re.split(r"\. ", text.replace("`", ""), maxsplit=1)[0].removesuffix(".")
    first = re.split("[:;]", first, maxsplit=1)[0] if short else first
    return first.replace("colour", "color")


def limits(one: Any) -> dict[str, Any]:
    """`min` and `max` of a number."""
    low, high = one.range.low, one.range.high
    found = {"min": low + _STEP * one.range.above}
    if high is not None:
        found["max"] = high - _STEP * one.range.below
    if one.kind is int and high is not None:
        found["max"] = min(found["max"], _LARGEST_INT)
    return {key: one.kind(value) for key, value in found.items()}
