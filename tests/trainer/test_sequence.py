"""Frames trained one after another; oracle: their files and events."""

import argparse
import json
import shutil
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gscore.commands import main
from gscore.commands import sequence as sequence_command
from gscore.config import DataConfig, TrainConfig
from gscore.config_file import load_config
from gscore.control import Control
from gscore.datasets.frames import SequenceFrame, choose_frames, find_frames
from gscore.errors import Cancelled, ConfigError, DatasetError, FormatError
from gscore.events import Done, Event, FrameStarted, Saved, SequenceDone, Started, from_line
from gscore.io.colmap.folder import read_model, write_model
from gscore.io.images.png import write_png
from gscore.io.images.read_image import read_image
from gscore.io.mesh.files import write_mesh
from gscore.io.ply.splats import read_ply
from gscore.io.sequences import read_sequence
from gscore.trainer.sequence import SequenceOptions, train_sequence

pytestmark = pytest.mark.usefixtures("fake_engine")

CONFIG = TrainConfig(iterations=40, max_splats=200, sh_degree=1, checkpoint_seconds=0)


def of_kind(events: list[Event], kind: type) -> list[Any]:
    """The events of a kind."""
    return [event for event in events if isinstance(event, kind)]


def numbers_in(folder: Path) -> list[int]:
    """Complete frames that sequence.json lists."""
    index = read_sequence(folder)
    assert index is not None
    return [entry["frame"] for entry in index.frames]


@pytest.mark.usefixtures("real_engine")
def test_each_frame_starts_from_the_one_before(frames: Path, tmp_path: Path) -> None:
    """Oracle: files of every frame; the number and the first PSNR of the splats handed over."""
    events: list[Event] = []
    out = tmp_path / "out"
    data = DataConfig(source=frames, eval=True, test_every=4)
    options = SequenceOptions(next_iterations=12, carried_opacity=1.0)
    limited = replace(CONFIG, steps_a_photo=1)  # of single trainings: frames take all steps
    result = train_sequence(limited, data, out, events.append, options=options)
    assert result.reason == "finished"
    assert [frame.number for frame in result.frames] == [0, 5, 10]
    assert {
        load_config(frame.folder / "config.json")[1].steps_a_photo for frame in result.frames
    } == {0}
    assert [event.iterations for event in of_kind(events, Started)] == [40, 12, 12]
    handed = [frame.metrics["splats"] for frame in result.frames]
    assert [event.splats for event in of_kind(events, Started)] == [150, *handed[:2]]
    reported = of_kind(events, FrameStarted)
    assert [(event.frame, event.place, event.frames) for event in reported] == [
        (0, 1, 3),
        (5, 2, 3),
        (10, 3, 3),
    ]
    assert reported[0].start == ""
    assert reported[1].start.endswith("frame_000000/point_cloud.ply")
    for frame in result.frames:
        assert (frame.folder / "report.html").is_file()
        assert not list(frame.folder.glob("checkpoints/*")), "complete frames need none"
    # The photos are the same in all frames, so in one world the training simply continues.
    psnr = [frame.metrics["psnr"] for frame in result.frames]
    assert psnr[2] > psnr[0] > 8
    assert isinstance(events[-1], SequenceDone)
    assert events[-1].metrics["psnr"] == pytest.approx(np.mean(psnr))


@pytest.mark.usefixtures("real_engine")
def test_all_frames_are_in_the_world_of_the_first(frames: Path, tmp_path: Path) -> None:
    """Oracle: equal cameras in all frames, and `gscore eval` of a later frame on its own."""
    out = tmp_path / "out"
    data = DataConfig(source=frames, eval=True, test_every=4)
    result = train_sequence(CONFIG, data, out, options=SequenceOptions(next_iterations=5))
    cameras = [json.loads((frame.folder / "cameras.json").read_text()) for frame in result.frames]
    for entry, first in zip(cameras[2], cameras[0], strict=True):
        np.testing.assert_allclose(entry["position"], first["position"], atol=1e-6)
    stored, how = load_config(result.frames[2].folder / "config.json")
    assert stored.rig == (frames / "000000").absolute()
    assert how.start_opacity == SequenceOptions().carried_opacity < 1
    report = tmp_path / "again"
    assert main(["eval", str(result.frames[2].folder), "-o", str(report), "--quiet"]) == 0
    again = json.loads((report / "metrics.json").read_text())["psnr"]
    assert again == pytest.approx(result.frames[2].metrics["psnr"], abs=1e-3)


def test_without_warm_start_and_rig_frames_know_nothing_of_each_other(
    frames: Path, tmp_path: Path
) -> None:
    """Oracle: the bits of a training of the frame alone."""
    out, alone = tmp_path / "out", tmp_path / "alone"
    options = SequenceOptions(frames="5:", warm_start=False, fixed_rig=False)
    train_sequence(CONFIG, DataConfig(source=frames), out, options=options)
    assert numbers_in(out) == [5, 10]
    run = ["train", str(frames / "000010"), "-o", str(alone), "--quiet", "--sh-degree", "1"]
    run += ["--iterations", "40", "--max-splats", "200", "--opaque-weight", "0"]
    assert main(run) == 0
    both = [folder / "point_cloud.ply" for folder in (out / "frame_000010", alone)]
    assert both[0].read_bytes() == both[1].read_bytes()


def test_an_interrupted_sequence_goes_on(frames: Path, tmp_path: Path) -> None:
    """Oracle: the bits of the uninterrupted sequence; unchanged complete frames."""
    data = DataConfig(source=frames)
    options = SequenceOptions(next_iterations=12)
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    train_sequence(CONFIG, data, whole, options=options)
    control = Control()

    def stop_in_the_second(event: Event) -> None:
        if isinstance(event, Started) and "000005" in event.output:
            control.stop("interrupted")

    result = train_sequence(CONFIG, data, cut, stop_in_the_second, control, options=options)
    assert (result.reason, len(result.frames)) == ("interrupted", 1)
    assert (cut / "frame_000005/checkpoints").is_dir()
    before = (cut / "frame_000000/point_cloud.ply").stat().st_mtime_ns
    events: list[Event] = []
    result = train_sequence(CONFIG, data, cut, events.append, options=options, resume=True)
    assert result.reason == "finished"
    assert [event.complete for event in of_kind(events, FrameStarted)] == [True, False, False]
    assert len(of_kind(events, Done)) == 2
    assert (cut / "frame_000000/point_cloud.ply").stat().st_mtime_ns == before
    for name in ("frame_000005", "frame_000010"):
        both = [(root / name / "point_cloud.ply").read_bytes() for root in (whole, cut)]
        assert both[0] == both[1]
    with pytest.raises(ConfigError, match="frame_000000 was trained with other options: sh_degree"):
        other = replace(CONFIG, sh_degree=2)
        train_sequence(other, data, cut, options=options, resume=True)


def test_a_frame_stopped_before_its_evaluation_is_not_complete(
    frames: Path, tmp_path: Path
) -> None:
    """Oracle: the frames and figures of an uninterrupted sequence."""
    data, control = DataConfig(source=frames), Control()
    options = SequenceOptions(next_iterations=12, frames="0:5")
    whole = train_sequence(CONFIG, data, tmp_path / "whole", options=options)

    def stop_after_the_last_step(event: Event) -> None:
        if isinstance(event, Saved) and event.path.endswith("000000/point_cloud.ply"):
            control.stop("interrupted")

    out = tmp_path / "out"
    result = train_sequence(CONFIG, data, out, stop_after_the_last_step, control, options=options)
    assert (result.reason, result.frames, numbers_in(out)) == ("interrupted", [], [])
    result = train_sequence(CONFIG, data, out, options=options, resume=True)
    assert result.headline["psnr"] == whole.headline["psnr"]


def test_stopping_before_the_first_step_leaves_nothing(frames: Path, tmp_path: Path) -> None:
    """Oracle: no folder."""
    control = Control()
    control.stop()
    with pytest.raises(Cancelled):
        train_sequence(CONFIG, DataConfig(source=frames), tmp_path / "out", control=control)
    assert not (tmp_path / "out").exists()


def test_the_command_line(frames: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: JSON at the end, an event on every line, options kept for --resume."""
    out = tmp_path / "out"
    base = ["sequence", str(frames), "-o", str(out), "--sh-degree", "0", "--max-splats", "200"]
    base += ["--iterations", "20", "--next-iterations", "5", "--eval", "--frames", "0:5:5"]
    assert main([*base, "--json", "--quiet"]) == 0
    facts = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (facts["reason"], facts["frames"], facts["frames_total"]) == ("finished", 2, 2)
    assert [entry["steps"] for entry in facts["per_frame"]] == [20, 5]
    assert facts["per_frame"][1]["start"] == "frame_000000"
    assert facts["psnr"] > 5
    assert main(["info", str(out)]) == 0
    seen = capsys.readouterr().out
    assert "a sequence, 2 of 2 frames complete" in seen
    assert "frame_000005: 150 splats, 5 steps" in seen
    assert main([*base, "--quiet"]) == 2
    assert "contains another sequence" in capsys.readouterr().err
    more = ["sequence", "-o", str(out), "--resume", "--frames", ":", "--events", "jsonl"]
    assert main(more) == 0
    lines = capsys.readouterr().out.splitlines()
    events = [from_line(line) for line in lines]
    assert None not in events
    assert [e.complete for e in events if isinstance(e, FrameStarted)] == [True, True, False]
    assert [e.iterations for e in events if isinstance(e, Started)] == [5]
    assert main([*base, "--overwrite"]) == 0
    seen = capsys.readouterr()
    assert "Frame 5 (2 of 2): 5 steps, from the previous frame" in seen.err
    assert "Finished: 2 of 2 frames" in seen.out
    assert not (out / "frame_000010").exists(), "of the sequence that was replaced"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{video}/none", "-o", "{out}"], "There is no folder"),
        (["{video}/000000", "-o", "{out}"], "contains no frames; expected a numbered folder"),
        (["{video}", "-o", "{out}", "--frames", "3"], "the sequence has 3 frames, 0, 5, 10."),
        (["{video}", "-o", "{out}", "--frames", "a-b"], "frames is 'a-b'; expected numbers"),
        (["{video}", "-o", "{out}", "--frames", "0:10:0"], "expected numbers such as"),
        (["{video}", "-o", "{out}", "--frame", "3"], "--frame 3 is not in the sequence"),
        (["{video}", "-o", "{out}", "--rig", "x"], "--rig is for a single training"),
        (["{video}", "-o", "{out}", "--resume"], "contains no run to resume"),
        (["{video}", "-o", "{out}", "--next-iterations", "-1"], "next_iterations must be"),
        (
            ["{video}", "-o", "{out}", "--carried-opacity", "0"],
            "carried_opacity must be more than 0, at most 1",
        ),
        (["{video}/{{frame:06x}}", "-o", "{out}"], "{frame:06d}"),
        (["{video}/{{number}}", "-o", "{out}"], "{frame:06d}"),
        (["{video}/{{frame:999999999d}}", "-o", "{out}"], "99 digits"),
        (["{video}/{{frame:٣d}}", "-o", "{out}"], "{frame:06d}"),
        (["{video}/{{frame}}x", "-o", "{out}"], "Nothing matches"),
        (["{video}", "-o", "{out}", "-i", "none"], "frame_000000: There is no image folder"),
    ],
)
def test_bad_input_is_one_sentence_and_leaves_nothing(
    frames: Path, refused: Callable[..., None], arguments: list[str], message: str
) -> None:
    """Oracle: code 2, one line with the error, no output folder."""
    refused("sequence", arguments, message, video=frames)


def test_a_broken_frame_is_named_and_the_others_stay(frames: Path, tmp_path: Path) -> None:
    """Oracle: the complete frames before it, and a resume after the repair."""
    data, out = DataConfig(source=frames), tmp_path / "out"
    points = frames / "000005/sparse/0/images.bin"
    good = points.read_bytes()
    points.write_bytes(good[:50])
    options = SequenceOptions(next_iterations=5)
    with pytest.raises(FormatError, match="frame_000005: "):
        train_sequence(CONFIG, data, out, options=options)
    assert numbers_in(out) == [0]
    points.write_bytes(good)
    result = train_sequence(CONFIG, data, out, options=options, resume=True)
    assert len(result.frames) == 3
    (out / "sequence.json").write_text("{}")
    with pytest.raises(FormatError, match=r"sequence\.json is not the list"):
        train_sequence(CONFIG, data, out, options=options, resume=True)


def test_moving_cameras_are_refused_as_a_rig(frames: Path, tmp_path: Path) -> None:
    """Oracle: a frame with exchanged cameras."""
    folder = frames / "000005"
    model = read_model(folder)
    names = [image.name for image in model.images]
    images = [replace(im, name=n) for im, n in zip(model.images, names[::-1], strict=True)]
    write_model(replace(model, images=images), folder / "sparse/0")
    with pytest.raises(DatasetError, match=r"frame_000005: The cameras of .* are not arranged"):
        options = SequenceOptions(next_iterations=5)
        train_sequence(CONFIG, DataConfig(source=frames), tmp_path / "out", options=options)


def test_frames_are_found_by_pattern(frames: Path, capture: Path, tmp_path: Path) -> None:
    """Oracle: the new folders; one model for all frames where photos alone change."""
    found = find_frames(DataConfig(source=Path(f"{frames}/{{frame:06d}}")))
    assert [frame.number for frame in found] == [0, 5, 10]
    assert found[1].data.source == frames / "000005"
    assert found[1].name == "frame_000005"
    for number in (3, 12):
        shutil.copytree(capture / "images", tmp_path / f"rig/photos/take{number}/rgb")
        shutil.copytree(capture / "images", tmp_path / f"rig/mattes/{number:04d}")
    (tmp_path / "rig/photos/take7").mkdir()
    (tmp_path / "rig/photos/other").mkdir()
    shutil.copytree(capture / "sparse", tmp_path / "rig/sparse")
    rig = DataConfig(
        source=tmp_path / "rig", images="photos/take{frame}/rgb", masks="mattes/{frame:04d}"
    )
    found = find_frames(rig)
    assert [frame.number for frame in found] == [3, 12]
    assert found[1].data == DataConfig(
        source=tmp_path / "rig", images="photos/take12/rgb", masks="mattes/0012"
    )
    options = SequenceOptions(next_iterations=4)
    result = train_sequence(replace(CONFIG, iterations=4), rig, tmp_path / "out", options=options)
    stored = [load_config(frame.folder / "config.json")[0] for frame in result.frames]
    assert [data.rig for data in stored] == [None, None], "they share their cameras already"
    assert len(read_ply(result.frames[1].folder / "point_cloud.ply")) > 100
    with pytest.raises(ConfigError, match="twice in one name"):
        find_frames(replace(rig, images="{frame}_{frame}"))
    shutil.copytree(frames / "000005", frames / "again_5")
    with pytest.raises(DatasetError, match="frame 5 twice"):
        find_frames(DataConfig(source=frames))


def test_frames_are_chosen() -> None:
    """Oracle: lists of numbers written out."""
    data = DataConfig(source=Path("x"))
    frames = [SequenceFrame(number=n, data=data) for n in (0, 5, 10, 15, 20, 21)]
    cases = {
        ":": [0, 5, 10, 15, 20, 21],
        "0:10": [0, 5, 10],
        "5:21:5": [5, 10, 15, 20],
        "15:": [15, 20, 21],
        ":5, 21": [0, 5, 21],
        "10": [10],
        "0::10": [0, 10, 20],
        "5:999999999999999999:5": [5, 10, 15, 20],  # immediately, for any frames between
    }
    for wanted, numbers in cases.items():
        assert [frame.number for frame in choose_frames(frames, wanted)] == numbers, wanted
    for wanted in ("", "1-3", "5,,6", "-5", "1:2:3:4", "9" * 19, "9" * 5000, f"0:{'9' * 5000}"):
        with pytest.raises(ConfigError):
            choose_frames(frames, wanted)


def test_flags_have_the_defaults_of_the_options() -> None:
    """Oracle: SequenceOptions, for a command line that names none of them."""
    parser = argparse.ArgumentParser()
    sequence_command.add_arguments(parser)
    args = parser.parse_args(["in", "-o", "out"])
    for field in fields(SequenceOptions):
        assert getattr(args, field.name) is None


def test_overwriting_a_sequence_spares_what_is_not_of_it(frames: Path, tmp_path: Path) -> None:
    """Oracle: a user's files next to the frames and in one, and a frame not made by gscore."""
    out = tmp_path / "out"
    options = SequenceOptions(frames="0,5", next_iterations=2)
    config, data = replace(CONFIG, iterations=3), DataConfig(source=frames)
    train_sequence(config, data, out, options=options)
    kept = ("frame_notes/config.json", "cut.blend", "frame_000000/previews/holiday.jpg")
    for name in kept:
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_text("x")
    train_sequence(config, data, out, options=options, overwrite=True)
    assert [(out / name).read_text() for name in kept] == ["x"] * 3
    (out / "frame_000005" / "config.json").write_text("{}")
    with pytest.raises(ConfigError, match=r"frame_000005 has .* no config\.json by gscore"):
        train_sequence(config, data, out, options=options, overwrite=True)
    assert (out / "frame_000000" / "point_cloud.ply").is_file(), "nothing was removed before"


def test_a_sequence_takes_no_place_of_a_run_or_the_capture(frames: Path, tmp_path: Path) -> None:
    """Oracle: the files of both."""
    run = tmp_path / "run"
    run.mkdir()
    (run / "point_cloud.ply").write_text("x")
    for place, words in ((run, "contains a single run"), (frames, "is the capture itself")):
        before = sorted(p for p in place.rglob("*"))
        with pytest.raises(ConfigError, match=words):
            train_sequence(CONFIG, DataConfig(source=frames), place, overwrite=True)
        assert sorted(p for p in place.rglob("*")) == before


def test_frames_with_masks_are_evaluated_inside_them(
    frames: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: psnr_masked of the frame's own metrics.json, in the list, the mean and the text."""
    capture = frames / "000000"
    (capture / "masks").mkdir()
    for photo in sorted((capture / "images").iterdir()):
        mask = np.zeros(read_image(photo).shape[:2], np.uint8)
        mask[:, ::2] = 255
        write_png(capture / "masks" / photo.name, mask)
    out = tmp_path / "out"
    line = ["sequence", str(frames), "-o", str(out), "--frames", "0", "--iterations", "3"]
    assert main([*line, "--max-splats", "200"]) == 0
    own = json.loads((out / "frame_000000" / "metrics.json").read_text())["psnr_masked"]
    index = read_sequence(out)
    assert index is not None
    assert index.frames[0]["psnr_masked"] == index.mean["psnr_masked"] == own
    assert f"PSNR inside the masks {own:.2f} dB" in capsys.readouterr().out


def test_each_frame_is_guided_by_its_own_mesh(frames: Path, tmp_path: Path) -> None:
    """Oracle: the files named in the frames' own texts; the pattern is kept for a resume."""
    out = tmp_path / "out"
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float64)
    for place, number in enumerate((0, 5, 10)):
        corners = square + np.array([0.1 * place, 0, 0])
        write_mesh(tmp_path / f"wall-{number:03d}.ply", corners, np.array([[0, 1, 2], [0, 2, 3]]))
    config = replace(CONFIG, guide_surface=tmp_path / "wall-{frame:03d}.ply")
    events: list[Event] = []
    control = Control()

    def take(event: Event) -> None:
        events.append(event)
        if isinstance(event, Done):
            control.stop()

    data = DataConfig(source=frames)
    train_sequence(config, data, out, take, control, options=SequenceOptions(next_iterations=5))
    assert load_config(out / "config.json")[1].guide_surface == config.guide_surface
    assert main(["sequence", "-o", str(out), "--resume", "--quiet"]) == 0
    assert numbers_in(out) == [0, 5, 10]
    guides = [
        load_config(out / f"frame_{n:06d}" / "config.json")[1].guide_surface for n in (0, 5, 10)
    ]
    assert [path.name for path in guides if path] == [
        "wall-000.ply",
        "wall-005.ply",
        "wall-010.ply",
    ]
    assert "Surface mesh wall-000.ply" in of_kind(events, Started)[0].decision("guide")
    (tmp_path / "wall-010.ply").unlink()
    with pytest.raises(ConfigError, match="the mesh of `--guide-surface` for frame 10"):
        train_sequence(config, data, tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_only_frames_left_to_train_need_their_meshes(frames: Path, tmp_path: Path) -> None:
    """Oracle: the remaining frames, without the meshes of complete frames and of other runs."""
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float64)
    walls = {number: tmp_path / f"wall-{number:03d}.ply" for number in (0, 5, 10)}

    def build(number: int) -> None:
        write_mesh(walls[number], square, np.array([[0, 1, 2], [0, 2, 3]]))

    config = replace(CONFIG, iterations=5, guide_surface=tmp_path / "wall-{frame:03d}.ply")
    options = SequenceOptions(next_iterations=5, keyframe_every=2)
    out, data = tmp_path / "out", DataConfig(source=frames)
    build(10)
    assert train_sequence(config, data, out, options=options, frame=10).reason == "finished"
    walls[10].unlink()
    train_sequence(config, data, out, options=options, frame=10)
    for number, more in ((5, {"frame": 5}), (0, {"resume": True})):
        with pytest.raises(ConfigError, match="the mesh of `--guide-surface` for frame 0"):
            train_sequence(config, data, out, options=options, **more)
        build(number)
    train_sequence(config, data, out, options=options, resume=True)
    assert numbers_in(out) == [0, 5, 10]
    for more in ({"frame": 10}, {}):
        with pytest.raises(ConfigError, match="the mesh of `--guide-surface` for frame 10"):
            train_sequence(config, data, out, options=options, overwrite=True, **more)
    assert numbers_in(out) == [0, 5, 10]
