"""Plan of a sequence: how each frame is trained, and which frames depend on others."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ...config import DataConfig, TrainConfig
from ...datasets.frames import SequenceFrame, of_frame
from ...errors import ConfigError
from ...sequence_options import SequenceOptions
from ...text_format import count_words
from ..files.run_folder import RunFolder

PER_FRAME = ("guide_surface", "guide_free")
"""Options of meshes, which may hold `{frame}`: each frame then has its own."""


@dataclass(frozen=True, kw_only=True)
class PlannedFrame:
    """One frame, with all that decides about its bits."""

    number: int
    folder: Path
    """Of its results."""
    config: TrainConfig
    data: DataConfig

    @property
    def start(self) -> Path | None:
        """PLY it starts from; None: from the points of its capture."""
        return self.config.start_splats


def plan_frames(
    frames: Sequence[SequenceFrame],
    config: TrainConfig,
    output: Path,
    options: SequenceOptions,
) -> list[PlannedFrame]:
    """Say of each frame how it is trained; no file is looked at.

    Args:
        frames: In the order in which they follow each other.
        config: Of the first frame and of all keyframes.
        output: Folder of the sequence.
        options: Which frames are keyframes, and what goes from one frame to the next.

    Raises:
        ConfigError: an option is for one frame alone, or names a frame's mesh wrongly.
    """
    if config.region is not None:
        raise ConfigError(
            "A region is trained in one frame: give --region to gscore train, not to gscore "
            "sequence."
        )
    config = replace(config, steps_a_photo=0, splats_a_photo=0)  # frames take what was asked for
    keys = {run[0] for run in independent_runs(len(frames), options)}
    found: list[PlannedFrame] = []
    for place, frame in enumerate(frames):
        own = config if place in keys else _after(found[-1], config, options)
        own = replace(
            own, **{name: of_frame(getattr(config, name), frame.number) for name in PER_FRAME}
        )
        data = _data_of(frame, frames[0], options)
        folder = output / frame.name
        found.append(PlannedFrame(number=frame.number, folder=folder, config=own, data=data))
    return found


def independent_runs(count: int, options: SequenceOptions) -> list[range]:
    """The places of all frames, cut into runs that need nothing of each other.

    Each run begins with a keyframe. Where they are follows from the options alone, so that it does
    not matter who trains which run, and when.
    """
    every = (options.keyframe_every or count) if options.warm_start else 1
    return [range(first, min(first + every, count)) for first in range(0, count, every)]


def check_guides(frames: Sequence[PlannedFrame]) -> None:
    """Raise ConfigError unless the meshes of frames that are to be trained are there: a sequence is
    not to end in its middle for want of one."""
    for frame in frames:
        for name in PER_FRAME:
            path = getattr(frame.config, name)
            if path is not None and not path.is_file():
                raise ConfigError(
                    f"There is no {path}, the mesh of --{name.replace('_', '-')} for frame "
                    f"{frame.number}. Put one there for each frame, or leave the frame out with "
                    "--frames."
                )


def check_shareable(runs: Sequence[range], processes: int) -> str:
    """A sentence where some of these processes get nothing to do; empty where all do.

    Raises:
        ConfigError: only one of them could do anything.
    """
    if len(runs) == 1 < processes:
        raise ConfigError(
            f"Each frame of this sequence starts from the one before, so {processes} processes "
            "cannot share them. --keyframe-every N lets every Nth frame start anew, from where one "
            "process goes on up to the next; or train with one process."
        )
    if len(runs) >= processes:
        return ""
    return (
        f"There are {len(runs)} runs of frames for {processes} processes, so "
        f"{count_words(processes - len(runs), 'process has', 'processes have')} nothing to do. A "
        "smaller --keyframe-every makes more runs."
    )


def run_of_frame(frames: Sequence[PlannedFrame], runs: Sequence[range], number: int) -> range:
    """The run that a frame belongs to.

    Raises:
        ConfigError: no frame that was asked for has this number.
    """
    for run in runs:
        if any(frames[place].number == number for place in run):
            return run
    raise ConfigError(
        f"--frame {number} is none of the frames of this sequence, {frames[0].number} to "
        f"{frames[-1].number} as --frames chooses them."
    )


def _after(before: PlannedFrame, config: TrainConfig, options: SequenceOptions) -> TrainConfig:
    return replace(
        config,
        iterations=options.next_iterations or max(1, config.iterations // 4),
        time_budget=config.time_budget / 4,
        start_splats=RunFolder(before.folder).point_cloud.absolute(),
        start_opacity=options.carried_opacity,
        prune_share=0.0,  # else each frame would have fewer than the one before
    )


def _data_of(frame: SequenceFrame, first: SequenceFrame, options: SequenceOptions) -> DataConfig:
    """What to read of a frame: with the first one's rig, unless both read the same cameras."""
    if not options.fixed_rig or frame.data.source == first.data.source:
        return frame.data
    return replace(frame.data, rig=first.data.source.absolute())
