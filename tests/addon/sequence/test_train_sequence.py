"""Oracle: the command line, a scripted `gscore sequence`, and the panels' text about both."""

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import bpy
import pytest

from addon import preferences
from addon.core import (
    FrameStarted,
    SequenceIndex,
    SequenceOptions,
    options_of,
    read_splats,
    write_splats,
)
from addon.panels.cameras import CapturePanel
from addon.panels.train import TrainSequencePanel
from addon.process import poll_timer
from addon.sequence import train_sequence
from addon.training import facts, lookups, options
from addon.training.options import Machine
from gscore.io.sequences import write_sequence
from tests.addon.captures import STUDIO
from tests.addon.drawn import drawn, labels
from tests.addon.fake_trainer import step
from tests.addon.trainings import splats, until

REAL = os.environ.get("GSCORE_TRAINER_PYTHON", "")
needs_trainer = pytest.mark.skipif(not REAL, reason="GSCORE_TRAINER_PYTHON names no Python")
Play = Callable[..., Path]
FRAME = {"event": "frame", "frame": 4, "place": 2, "frames": 4, "output": "o", "iterations": 100}
FRAME |= {"start": "", "complete": False}
DONE = {"event": "sequence", "reason": "finished", "frames": 4, "path": "p", "train_seconds": 9.0}
DONE |= {"metrics": {"psnr": 31.234}}


@pytest.fixture
def video(scene: bpy.types.Scene, tmp_path: Path, no_work: None) -> bpy.types.Scene:
    """A scene whose capture is a folder of four numbered captures."""
    for number in (0, 4, 8, 12):
        folder = tmp_path / "video" / f"{number:06d}"
        shutil.copytree(STUDIO / "sparse", folder / "sparse")
        (folder / "images").mkdir()
    scene.gscore.capture_path = str(tmp_path / "video")
    return scene


def panel() -> str:
    """Text of the panel, once the folders are scanned."""
    drawn(TrainSequencePanel)
    until(lambda: not poll_timer.poll() or "Searching" not in drawn(TrainSequencePanel))
    return drawn(TrainSequencePanel)


def settle() -> str:
    """The same, after all lookups have expired."""
    lookups.sequences.expire()
    drawn(TrainSequencePanel)
    until(lambda: not lookups.busy())
    lookups.collect()
    return drawn(TrainSequencePanel)


def leave(output: Path, numbers: tuple[int, ...]) -> None:
    """Results of a training."""
    frames = [{"frame": n, "folder": f"frame_{n:06d}"} for n in numbers]
    for entry in frames:
        write_splats(output / entry["folder"] / "point_cloud.ply", splats(50 + entry["frame"]))
    index = SequenceIndex(options={}, frames=frames, mean={"frames_total": 4})
    write_sequence(output, index, version="0")


def test_from_button_to_timeline(video, tmp_path: Path, play: Play) -> None:
    """The arguments; the bar; at the end the frames play in the scene."""
    called = play({"say": FRAME}, step(50), {"await": "go"}, {"say": DONE})
    text = panel()
    facts.refresh(video)
    said = drawn(CapturePanel)
    assert "4 captures, one per frame" in said and "Find Cameras" not in said
    assert "4: 0 to 12" in text and "(Train Sequence)" in text and "<next_iterations>" in text
    video.gscore_train_sequence.frames = "0:12:4"
    assert bpy.ops.gscore.train_sequence() == {"FINISHED"}
    job = train_sequence.job_of(video)
    until(lambda: job.progress is not None)
    assert "[38%] Frame 4, 2 of 4: step 50" in drawn(TrainSequencePanel)
    with pytest.raises(RuntimeError, match="being trained already"):
        bpy.ops.gscore.train_sequence()
    output = train_sequence.output_of(video)
    leave(output, (0, 4, 8, 12))
    job._process.send("go")
    until(lambda: job.ended)
    line = json.loads(called.read_text())
    assert line[:4] == ["-u", "-m", "gscore", "sequence"] and line[4] == str(tmp_path / "video")
    assert line[line.index("--frames") + 1] == "0:12:4"
    assert line[line.index("-o") + 1] == str(output)
    text = settle()
    assert "4 frames are complete, mean PSNR 31.23 dB." in text
    assert "4 of 4 frames are trained." in text and "(Import Splat Sequence)" in text
    bpy.ops.gscore.import_sequence(directory=str(output))
    video.frame_set(3)
    assert len(bpy.context.object.data.vertices) == 58
    assert len(read_splats(output / "frame_000008" / "point_cloud.ply")) == 58


def test_stop_and_go_on(video, play: Play) -> None:
    """The trainer is stopped; the button then resumes, and Start Over opens a dialog."""
    stopped = DONE | {"reason": "stopped", "frames": 1}
    play({"say": FRAME}, {"await": "stop"}, {"say": stopped})
    panel()
    bpy.ops.gscore.train_sequence()
    job = train_sequence.job_of(video)
    until(lambda: job.last(FrameStarted) is not None)
    leave(train_sequence.output_of(video), (0,))
    assert bpy.ops.gscore.stop_sequence() == {"FINISHED"}
    until(lambda: job.ended)
    text = settle()
    assert "Stopped; complete frames are kept" in text and "1 of 4 frames are trained" in text
    assert "(Resume)" in text and "(Start Over)" in text
    with pytest.raises(RuntimeError, match="press Resume to continue it"):
        bpy.ops.gscore.train_sequence()
    called = play({"say": DONE})
    bpy.ops.gscore.train_sequence(resume=True, wait=True)
    assert "--resume" in json.loads(called.read_text())
    with pytest.raises(RuntimeError, match="No sequence is being trained"):
        bpy.ops.gscore.stop_sequence()


def test_failures_are_shown_at_the_button(video, play: Play) -> None:
    """The error of the trainer; and of folders without frames."""
    play(
        {"say": {"event": "error", "type": "DatasetError", "message": "Frame 4 is broken."}},
        {"exit": 2},
    )
    panel()
    with pytest.raises(RuntimeError, match="Frame 4 is broken"):
        bpy.ops.gscore.train_sequence(wait=True)
    assert "Frame 4 is broken" in drawn(TrainSequencePanel)
    video.gscore.capture_path = str(STUDIO)
    assert "contains no frames" in panel()
    video.gscore.capture_path = str(STUDIO / "gone")
    assert "There is no folder" in drawn(TrainSequencePanel)


def test_missing_input_is_named_by_its_panel_field(video, tmp_path: Path) -> None:
    """Oracle: the name of the field of the photos' folder; no flag of the command line."""
    (tmp_path / "empty").mkdir()
    video.gscore.capture_path = str(tmp_path / "empty")
    name = video.gscore.bl_rna.properties["images"].name
    text = panel()
    assert f'give its folder, and frames/{{frame:06d}} as "{name}".' in text and "--" not in text
    facts.refresh(video)
    video.gscore.capture_path = str(STUDIO)
    until(lambda: "<images>" in drawn(CapturePanel))
    assert name not in labels(CapturePanel)  # the field has its own name


def test_arguments_are_those_of_a_training_and_its_own(scene) -> None:
    """Oracle: gscore's own table of options; only what differs from the defaults is given."""
    own = scene.gscore_train_sequence
    places = {"source": Path("/s"), "output": Path("/o"), "machine": Machine()}
    line = options.new_sequence(scene.gscore, own, **places)
    assert not {"--frames", "--next-iterations", "--no-warm-start"} & set(line)
    own.frames, own.next_iterations, own.warm_start = "1,2", 70, False
    line = options.new_sequence(scene.gscore, own, overwrite=True, **places)
    assert line[:4] == ["sequence", "/s", "-o", "/o"] and "--overwrite" in line
    assert line[-5:] == ["--frames", "1,2", "--next-iterations", "70", "--no-warm-start"]
    assert {"frames", "next_iterations", "warm_start"} <= set(options_of(SequenceOptions))
    again = options.resumed_sequence(own, output=Path("/o"), machine=Machine())
    assert again[:4] == ["sequence", "-o", "/o", "--resume"] and again[-2:] == ["--frames", "1,2"]


def two_real_frames(video: bpy.types.Scene, tmp_path: Path) -> None:
    """Make frames 0 and 4 from the studio, for a few steps of the given trainer."""
    for number in (0, 4):
        folder = tmp_path / "video" / f"{number:06d}" / "images"
        folder.rmdir()
        shutil.copytree(STUDIO / "images", folder)
    preferences.get().python_path = REAL
    settings, own = video.gscore, video.gscore_train_sequence
    settings.iterations, settings.resolution, settings.width = 20, "WIDTH", 48
    settings.use_masks, settings.max_splats, settings.eval = False, 2000, False
    own.frames = "0,4"


@needs_trainer
def test_a_real_sequence(video, tmp_path: Path) -> None:
    """Oracle: `gscore sequence` itself, a few steps of two frames of the studio."""
    two_real_frames(video, tmp_path)
    panel()
    bpy.ops.gscore.train_sequence(wait=True)
    assert train_sequence.job_of(video).sentence.startswith("2 frames are complete")
    bpy.ops.gscore.import_sequence(directory=str(train_sequence.output_of(video)))
    ob = bpy.context.object
    counts = []
    for frame in (1, 2):
        video.frame_set(frame)
        counts.append(len(ob.data.vertices))
        folder = train_sequence.output_of(video) / f"frame_{4 * (frame - 1):06d}"
        assert counts[-1] == len(read_splats(folder / "point_cloud.ply")) > 100
