"""Plan of a sequence: options and dependencies of each frame."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ...config import DataConfig, TrainConfig
from ...datasets.frames import SequenceFrame, of_frame
from ...errors import ConfigError
from ...option_marks import mark_option
from ...sequence_options import SequenceOptions
from ...text_format import count_text
from ..files.run_folder import RunFolder

PER_FRAME = ("guide_surface", "guide_free")
"""Options of mesh files that may contain `{frame}` for one mesh per frame."""


@dataclass(frozen=True, kw_only=True)
class PlannedFrame:
    """One frame with all options that determine its bits."""

    number: int
    folder: Path
    """Folder of its results."""
    config: TrainConfig
    data: DataConfig

    @property
    def start(self) -> Path | None:
        """PLY of the start splats; None: starts from the points of its capture."""
        return self.config.start_splats


def plan_frames(
    frames: Sequence[SequenceFrame],
    config: TrainConfig,
    output: Path,
    options: SequenceOptions,
) -> list[PlannedFrame]:
    """Derive the options of each frame without reading files.

    Args:
        frames: Frames in temporal order.
        config: Options of the first frame and of all keyframes.
        output: Folder of the sequence.
        options: Options of keyframes and of the start from the previous frame.

    Raises:
        ConfigError: an option is for single frames only, or the name of a frame's mesh is invalid.
    """
    if config.region is not None:
        raise ConfigError(
            "A region can be trained in a single frame only: use `--region` with gscore train, not "
            "with gscore sequence."
        )
    config = replace(config, steps_a_photo=0, splats_a_photo=0)  # frames use the requested numbers
    keys = {run[0] for run in independent_runs(len(frames), options)}
    planned: list[PlannedFrame] = []
    for place, frame in enumerate(frames):
        own = config if place in keys else _after(planned[-1], config, options)
        own = replace(
            own, **{name: of_frame(getattr(config, name), frame.number) for name in PER_FRAME}
        )
        data = _data_of(frame, frames[0], options)
        folder = output / frame.name
        planned.append(PlannedFrame(number=frame.number, folder=folder, config=own, data=data))
    return planned


def independent_runs(count: int, options: SequenceOptions) -> list[range]:
    """Split the indices of all frames into independent runs, each starting with a keyframe.

    The split depends only on the options, so any process may train any run at any time.
    """
    every = (options.keyframe_every or count) if options.warm_start else 1
    return [range(first, min(first + every, count)) for first in range(0, count, every)]


def check_guides(frames: Sequence[PlannedFrame]) -> None:
    """Raise ConfigError unless the guide meshes of all frames exist, so that a sequence does not
    fail halfway."""
    for frame in frames:
        for name in PER_FRAME:
            path = getattr(frame.config, name)
            if path is not None and not path.is_file():
                raise ConfigError(
                    f"There is no {path}, the mesh of {mark_option(name)} for frame "
                    f"{frame.number}. Add a mesh for each frame, or exclude the frame with "
                    "`--frames`."
                )


def check_shareable(runs: Sequence[range], processes: int) -> str:
    """Return a warning if some processes have no work, else an empty string.

    Raises:
        ConfigError: only one process would have work.
    """
    if len(runs) == 1 < processes:
        raise ConfigError(
            f"Each frame of this sequence starts from the previous one, so {processes} processes "
            "cannot share them. Use `--keyframe-every N`, which trains every Nth frame from its "
            "own points, so that processes share the parts between; or train with one process."
        )
    if len(runs) >= processes:
        return ""
    return (
        f"There are {len(runs)} runs of frames for {processes} processes, so "
        f"{count_text(processes - len(runs), 'process has', 'processes have')} no work. A "
        "smaller `--keyframe-every` makes more runs."
    )


def run_of_frame(frames: Sequence[PlannedFrame], runs: Sequence[range], number: int) -> range:
    """Return the run that contains a frame.

    Raises:
        ConfigError: no requested frame has this number.
    """
    for run in runs:
        if any(frames[place].number == number for place in run):
            return run
    raise ConfigError(
        f"`--frame {number}` is not in the sequence, whose frames are {frames[0].number} to "
        f"{frames[-1].number} as selected by `--frames`."
    )


def _after(before: PlannedFrame, config: TrainConfig, options: SequenceOptions) -> TrainConfig:
    return replace(
        config,
        iterations=options.next_iterations or max(1, config.iterations // 4),
        time_budget=config.time_budget / 4,
        start_splats=RunFolder(before.folder).point_cloud.absolute(),
        start_opacity=options.carried_opacity,
        prune_share=0.0,  # else the number of splats would fall from frame to frame
    )


def _data_of(frame: SequenceFrame, first: SequenceFrame, options: SequenceOptions) -> DataConfig:
    """Data options of a frame: with the rig of the first frame, unless they share a source."""
    if not options.fixed_rig or frame.data.source == first.data.source:
        return frame.data
    return replace(frame.data, rig=first.data.source.absolute())
