"""Keyframes and the frames that follow them; oracle: places counted by hand."""

from pathlib import Path

import pytest

from gscore.config import DataConfig, TrainConfig
from gscore.datasets.frames import SequenceFrame
from gscore.errors import ConfigError
from gscore.sequence_options import SequenceOptions
from gscore.trainer.frames.plan import (
    PlannedFrame,
    check_guides,
    independent_runs,
    plan_frames,
    run_of_frame,
)


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
    assert independent_runs(5, SequenceOptions(keyframe_every=2)) == every_second
    assert independent_runs(5, SequenceOptions()) == [range(5)]
    alone = independent_runs(3, SequenceOptions(warm_start=False, keyframe_every=2))
    assert alone == [range(1), range(1, 2), range(2, 3)]


def test_a_keyframe_is_trained_like_the_first_frame() -> None:
    """Oracle: steps, and the folder of the initial splats of a frame."""
    frames = planned(SequenceOptions(keyframe_every=2))
    assert [frame.config.iterations for frame in frames] == [40, 10, 40, 10, 40]
    starts = [frame.start.parent.name if frame.start else "" for frame in frames]
    assert starts == ["", "frame_000000", "", "frame_000020", ""]
    assert {frame.data.rig for frame in frames} == {None, Path("0").absolute()}


def test_a_frame_is_found_in_its_run() -> None:
    """Oracle: runs written out; the sentence about a frame outside the selection."""
    options = SequenceOptions(keyframe_every=2)
    frames, runs = planned(options), independent_runs(5, options)
    assert run_of_frame(frames, runs, 30) == run_of_frame(frames, runs, 20) == range(2, 4)
    with pytest.raises(ConfigError, match="`--frame 3` is not in the sequence, whose frames"):
        run_of_frame(frames, runs, 3)


def test_each_frame_has_the_mesh_of_its_number(tmp_path: Path) -> None:
    """Oracle: names written out; the sentences on a missing mesh and on other braces."""
    frames = [SequenceFrame(number=n, data=DataConfig(source=Path(str(n)))) for n in (4, 8)]
    config = TrainConfig(
        guide_surface=tmp_path / "wall-{frame:04d}.ply", guide_free=tmp_path / "floor.ply"
    )
    plan = plan_frames(frames, config, Path("out"), SequenceOptions())
    names = ["wall-0004.ply", "wall-0008.ply"]
    assert [frame.config.guide_surface for frame in plan] == [tmp_path / name for name in names]
    assert {frame.config.guide_free for frame in plan} == {tmp_path / "floor.ply"}
    for name in ("floor.ply", names[0]):
        (tmp_path / name).touch()
    with pytest.raises(
        ConfigError, match=r"wall-0008.ply, the mesh of `--guide-surface` for frame 8"
    ):
        check_guides(plan)
    (tmp_path / names[1]).touch()
    check_guides(plan)
    wrong = TrainConfig(guide_free=Path("{number}.ply"))
    with pytest.raises(ConfigError, match=r"expected \{frame\} or \{frame:06d\} in the braces"):
        plan_frames(frames, wrong, Path("out"), SequenceOptions())
