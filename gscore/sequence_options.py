"""Sequence options, in addition to the options of its frames."""

from dataclasses import dataclass

from .options import Range, check_options, option


@dataclass(frozen=True, kw_only=True)
class SequenceOptions:
    """What a sequence has besides the options of its frames."""

    frames: str = option(
        ":",
        "Which frames: `0,5,12`, `0:30` or `0:30:5` (first, last, step); a colon alone: all.",
        group="sequence",
        metavar="LIST",
        basic=True,
    )
    next_iterations: int = option(
        0,
        "Steps of later frames; 0: a quarter of those of the first. A time budget of the first is "
        "a quarter for them too.",
        group="sequence",
        range=Range(),
        unit="steps",
        basic=True,
    )
    warm_start: bool = option(
        True,
        "Start each frame from the splats of the one before. Off: every frame starts from its own "
        "points and takes as many steps as the first.",
        group="sequence",
        basic=True,
    )
    keyframe_every: int = option(
        0,
        "Every how many frames one is a keyframe, trained like the first. From each, frames go on "
        "to the next by themselves, so several processes can take them in turn. 0: the first only.",
        group="sequence",
        range=Range(),
        unit="frames",
        basic=True,
    )
    carried_opacity: float = option(
        0.6,
        "Share of its opacity that a splat takes into the next frame. What no photo asks for fades "
        "so, and what moved away makes room.",
        group="sequence",
        range=Range(high=1, above=True),
        basic=True,
    )
    fixed_rig: bool = option(
        True,
        "The cameras do not move from frame to frame. All frames get those of the first, in its "
        "world; off: the frames' own cameras, which then must be in one world already.",
        group="sequence",
        basic=True,
    )
    keep_checkpoints: bool = option(
        False,
        "Keep the last checkpoint of frames that are complete.",
        group="sequence",
    )

    def __post_init__(self) -> None:
        check_options(self)
