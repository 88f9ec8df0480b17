"""Training properties of a scene: capture, training settings, and result; properties made
from gscore's options.
"""

import re
from pathlib import Path
from typing import Any

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from .. import compat, run_links
from ..core import (
    PRESETS,
    Background,
    DataConfig,
    SequenceOptions,
    Strategy,
    Switch,
    TrainConfig,
    options_of,
)
from ..interface.option_labels import CHOICES, LABELS
from . import facts
from .options import AS_PRESET, BY_WIDTH

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


_DATA, _TRAIN = PRESETS["normal"](Path())

_STRATEGIES = {
    Strategy.DEFAULT: ("Grow by Gradient", "Add splats where the rendered photos have errors"),
    Strategy.MCMC: ("Relocate", "Move splats without effect to where they are needed (MCMC)"),
}
_BACKGROUNDS = {
    Background.AUTO: ("Automatic", "Random colors for photos with opacity, else black"),
    Background.BLACK: ("Black", "Black behind the splats"),
    Background.WHITE: ("White", "White behind the splats"),
    Background.RANDOM: ("Random", "Another color at each step, so that no splats can imitate it"),
}
_DEPTH_MODES = {
    Switch.AUTO: ("Automatic", "Use depth maps for captures with few photos"),
    Switch.ON: ("Always", "Use all depth maps"),
    Switch.OFF: ("Never", "Train from the photos alone"),
}
_SKIES = {
    Switch.AUTO: ("Automatic", "Add distant splats where the photos show the sky"),
    Switch.ON: ("Sphere", "Add distant splats all around, which hide the scene from outside"),
    Switch.OFF: ("None", "Add no distant splats"),
}
_DEPTH_REPORTS = (
    ("MAPS", "Maps", "The current depth maps, and their agreement with the SfM points"),
    ("RUN", "Training", "Use of the depth maps in the training of the output folder"),
)
_RESOLUTIONS = (
    (AS_PRESET, "From Preset", "Scale photos down to the width of the preset"),
    ("1", "Full", "Original size"),
    ("2", "Half", "Half the width and height"),
    ("4", "Quarter", "A quarter of the width and height"),
    ("8", "Eighth", "An eighth of the width and height"),
    (BY_WIDTH, "Width", "Scale photos to a width in pixels"),
)
_MASK_MODES = (
    ("auto", "Automatic", "Opacity of the photos if they have any, else the masks folder"),
    ("composite", "Opacity", "Masks are opacity: splats appear only where the mask is white"),
    ("ignore", "Ignore Masked", "Pixels with a black mask are not trained"),
)


def purpose_of(preset: str) -> str:
    """The first clause of a preset's docstring. The rest states the duration for a typical capture;
    the panel has an estimate for this one."""
    return (PRESETS[preset].__doc__ or "").partition(", ")[0].strip()


def _items(kinds: Any, texts: dict[Any, tuple[str, str]]) -> list[tuple[str, str, str]]:
    return [(str(kind), *texts.get(kind, (str(kind), str(kind)))) for kind in kinds]


def apply_preset(settings: "SceneSettings") -> None:
    """Set the values of the chosen preset."""
    _, train = PRESETS[settings.preset](Path())
    settings.iterations = train.iterations
    settings.max_splats = train.max_splats
    settings.sh_degree = train.sh_degree
    settings.resolution = AS_PRESET


def _capture_changed(settings: "SceneSettings", context: bpy.types.Context) -> None:
    """Load the output folder, splats and test view of a newly chosen capture, and start the lookup
    of its facts for the panel."""
    run_links.follow_capture(settings)
    facts.capture(settings.id_data)


class SceneSettings(run_links.LinkProperties, bpy.types.PropertyGroup):
    """`Scene.gscore`; properties have the names of gscore's options."""

    capture_path: StringProperty(
        name="Capture",
        description="Folder of photos, with or without a COLMAP model of their cameras; or a video",
        subtype="DIR_PATH",
        options=compat.BLEND_RELATIVE,
        update=_capture_changed,
    )
    preset: EnumProperty(
        name="Preset",
        description="Quality and duration of the training; sets the values below",
        items=[(name, name.capitalize(), purpose_of(name)) for name in PRESETS],
        default="normal",
        update=lambda settings, context: apply_preset(settings),
    )
    iterations: declared(_TRAIN, "iterations", "Steps", soft_min=100, soft_max=30_000)
    max_splats: declared(_TRAIN, "max_splats", "Max Splats", soft_min=10_000, soft_max=2_000_000)
    sh_degree: declared(_TRAIN, "sh_degree", "Color Degree")
    resolution: EnumProperty(
        name="Photo Size",
        description="Size of the photos in training; half the width takes a quarter of the time",
        items=_RESOLUTIONS,
        default=AS_PRESET,
    )
    width: IntProperty(
        name="Photo Width",
        description="Width of the photos in training, in pixels",
        default=_DATA.max_width,
        min=9,
        soft_min=200,
        soft_max=3200,
        subtype="PIXEL",
    )
    eval: declared(_DATA, "eval", "Hold Out Test Views", default=True)
    test_every: IntProperty(
        name="Every n-th Photo",
        description="Every n-th photo by name is a test view, unless the capture has its own split",
        default=_DATA.test_every,
        min=2,
        soft_max=50,
    )
    use_masks: BoolProperty(
        name="Use Masks",
        description="Use the alpha channel of the photos, or the masks folder of the capture",
        default=True,
    )
    mask_mode: declared(_DATA, "mask_mode", "Mask Mode", items=_MASK_MODES)
    invert_masks: declared(_DATA, "invert_masks", "Invert Masks")
    depth_mode: declared(_TRAIN, "depth_mode", "Use Depth", items=_items(Switch, _DEPTH_MODES))
    depth_shown: EnumProperty(
        name="Report",
        description="Report on the depth maps to show",
        items=_DEPTH_REPORTS,
        default="RUN",
    )
    images: declared(_DATA, "images", "Photo Folder", update=_capture_changed)
    strategy: declared(_TRAIN, "strategy", "Strategy", items=_items(Strategy, _STRATEGIES))
    background: declared(_TRAIN, "background", "Background", items=_items(Background, _BACKGROUNDS))
    antialias: declared(_TRAIN, "antialias", "Anti-Aliasing")
    sky: declared(_TRAIN, "sky", "Sky", items=_items(Switch, _SKIES))
    finest: declared(_TRAIN, "finest", "Finest Detail")
    free_space: declared(_TRAIN, "free_space", "Free Space")
    seed: declared(_TRAIN, "seed", "Seed")
    time_budget: declared(
        _TRAIN,
        "time_budget",
        "Time Budget",
        soft_max=7200.0,
        subtype="TIME_ABSOLUTE",
        unit="TIME_ABSOLUTE",
    )
    target_psnr: declared(_TRAIN, "target_psnr", "Target PSNR", soft_max=40.0)
    early_stop: declared(_TRAIN, "early_stop", "Stop Early")
    live_splats: BoolProperty(
        name="Live Splats",
        description="Show the splats in the viewport while they are trained",
        default=True,
    )
    outcome_of: StringProperty(
        name="Outcome Of",
        description="Capture that Output, Result and Test View belong to",
        options={"HIDDEN"},
    )
    outcomes: CollectionProperty(
        name="Outcomes",
        description="Output, Result and Test View of the other captures",
        type=run_links.RunLinks,
    )


PROPERTIES = ((bpy.types.Scene, "gscore", PointerProperty(type=SceneSettings)),)
