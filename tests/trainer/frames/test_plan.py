"""Frames that are keyframes, and those that follow; oracle: places counted by hand."""

from pathlib import Path

import pytest

from gscore.config import DataConfig, TrainConfig
from gscore.datasets.frames import SequenceFrame
from gscore.errors import ConfigError
from gscore.sequence_options import SequenceOptions
from gscore.trainer.frames.plan import PlannedFrame, plan_frames, run_with, runs_of


def planned(options: SequenceOptions) -> list[PlannedFrame]:
    """Frames 0, 10, 20, 30 and 40."""
    frames = [
        SequenceFrame(number=number, data=DataConfig(source=Path(str(number))))
        for number in range(0, 50, 10)
    ]
    return plan_frames(frames, TrainConfig(iterations=40), Path("out"), options)


def test_runs_begin_at_keyframes() -> None:
    """Oracle: runs written out; without warm start each frame is one."""
    every_second = [range(2), range(2, 4), range(4, 5)]
    assert runs_of(5, SequenceOptions(keyframe_every=2)) == every_second
    assert runs_of(5, SequenceOptions()) == [range(5)]
    alone = runs_of(3, SequenceOptions(warm_start=False, keyframe_every=2))
    assert alone == [range(1), range(1, 2), range(2, 3)]


def test_a_keyframe_is_trained_like_the_first_frame() -> None:
    """Oracle: steps, and the folder of the splats that a frame starts from."""
    frames = planned(SequenceOptions(keyframe_every=2))
    assert [frame.config.iterations for frame in frames] == [40, 10, 40, 10, 40]
    starts = [frame.start.parent.name if frame.start else "" for frame in frames]
    assert starts == ["", "frame_000000", "", "frame_000020", ""]
    assert {frame.data.rig for frame in frames} == {None, Path("0").absolute()}


def test_a_frame_is_found_in_its_run() -> None:
    """Oracle: runs written out; the sentence about a frame that was not asked for."""
    options = SequenceOptions(keyframe_every=2)
    frames, runs = planned(options), runs_of(5, options)
    assert run_with(frames, runs, 30) == run_with(frames, runs, 20) == range(2, 4)
    with pytest.raises(ConfigError, match="--frame 3 is none of the frames of this sequence, 0 to"):
        run_with(frames, runs, 3)
