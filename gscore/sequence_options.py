"""Sequence options, in addition to the options of its frames."""

from dataclasses import dataclass
from functools import partial

from .options import Range, check_options, option

_option = partial(option, group="sequence")


@dataclass(frozen=True, kw_only=True)
class SequenceOptions:
    """Options of a sequence."""

    frames: str = _option(
        ":",
        "Frames to train: `0,5,12`, `0:30` or `0:30:5` (first, last, step); a colon alone: all.",
        metavar="LIST",
        basic=True,
    )
    next_iterations: int = _option(
        0,
        "Steps of each later frame; 0: a quarter of the first frame's. The time budget of a later "
        "frame is a quarter too.",
        unit="steps",
        basic=True,
    )
    warm_start: bool = _option(
        True,
        "Start each frame from the splats of the previous one. Off: each frame starts from its own "
        "points and takes the steps of the first.",
        basic=True,
    )
    keyframe_every: int = _option(
        0,
        "Frames between two keyframes, which are trained like the first; 0: the first only. "
        "Intervals between keyframes are independent, so several processes can train them.",
        unit="frames",
        basic=True,
    )
    carried_opacity: float = _option(
        0.6,
        "Factor of opacities from one frame to the next. Splats that no photo needs then fade, "
        "such as those of objects that moved away.",
        range=Range(high=1, above=True),
        basic=True,
    )
    fixed_rig: bool = _option(
        True,
        "The cameras are the same in all frames. Poses and world are those of the first frame; "
        "off: each frame's own cameras, which must share one world.",
        basic=True,
    )
    keep_checkpoints: bool = _option(False, "Keep the last checkpoint of completed frames.")

    def __post_init__(self) -> None:
        check_options(self)
