"""Oracle: the folders, objects and pictures of one capture after another was chosen and trained."""

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from addon import stored_paths
from addon.cameras.lookup import find_root, panel_root
from addon.core import PRESETS, Splats, write_splats
from addon.panels.cameras import CapturePanel
from addon.paths import output_folder
from addon.process import poll_timer
from addon.training import facts, operators, start_training
from addon.training.training_job import Job
from gscore.config_file import config_json
from tests.addon.captures import STUDIO
from tests.addon.drawn import drawn
from tests.addon.fake_trainer import STARTED, finish, step
from tests.addon.splat_scenes import error_of
from tests.addon.trainings import positions, splats, until


@pytest.fixture
def two(scene: bpy.types.Scene, tmp_path: Path, play: Callable[..., Path]) -> SimpleNamespace:
    """A scene and two captures, plush and studio, and `play`."""
    folders = [tmp_path / name for name in ("plush", "studio")]
    for capture in folders:
        shutil.copytree(STUDIO, capture)
    plush, studio = folders
    return SimpleNamespace(scene=scene, plush=plush, studio=studio, tmp=tmp_path, play=play)


def run(two: SimpleNamespace, *script: dict, name: str = "p") -> None:
    """Let the next training play a script."""
    two.play({"say": STARTED}, *script, name=name)


def trained(two: SimpleNamespace, capture: Path, model: Splats) -> Job:
    """Choose a capture and train it with a fake that writes a run with these splats."""
    two.scene.gscore.capture_path = str(capture)
    output = output_folder(two.scene)
    write_splats(two.tmp / f"{capture.name}.ply", model)
    run(two, finish(str(two.tmp / f"{capture.name}.ply")), name=f"python of {capture.name}")
    job = start_training.train(two.scene, wait=True)
    leave_run(output, capture, model)
    return job


def leave_run(output: Path, capture: Path, model: Splats, steps: int = 3000) -> None:
    """Write the files of a training with a number of steps."""
    (output / "checkpoints").mkdir(parents=True, exist_ok=True)
    (output / "checkpoints" / f"step_{steps:08d}.safetensors").write_bytes(b"x")
    (output / "config.json").write_text(config_json(*PRESETS["preview"](capture)))
    write_splats(output / "point_cloud.ply", model)


def contents(folder: Path) -> dict[Path, bytes]:
    """Every file of a folder."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_second_capture_leaves_the_first_alone(two: SimpleNamespace) -> None:
    """Plush's folder, object and picture are unchanged, and restored when it is chosen."""
    settings = two.scene.gscore
    first, second = splats(10, 1), splats(20, 2)
    trained(two, two.plush, first)
    plush = settings.result
    picture = settings.preview = bpy.data.images.new("plush view", 4, 4)
    folder = output_folder(two.scene)
    before = contents(folder)
    settings.capture_path = str(two.studio / "sparse" / "0")
    assert (settings.output_path, settings.result, settings.preview) == ("", None, None)
    assert output_folder(two.scene) == two.tmp / "studio_splats"
    trained(two, two.studio, second)
    studio = settings.result
    assert studio is not plush and contents(folder) == before
    np.testing.assert_array_equal(positions(plush), first.means)
    np.testing.assert_array_equal(positions(studio), second.means)
    settings.capture_path = str(two.plush)
    assert (settings.result, settings.preview) == (plush, picture)
    assert output_folder(two.scene) == folder
    settings.capture_path = str(two.studio)
    assert settings.result == studio and len(settings.outcomes) == 1


def test_start_over_names_what_it_replaces(two: SimpleNamespace) -> None:
    """The dialog has the folder's path, steps and date, and the object's name."""
    trained(two, two.plush, splats(10))
    settings, folder = two.scene.gscore, output_folder(two.scene)
    for path in contents(folder):
        os.utime(path, (1.7e9, 1.7e9))  # 14 November 2023
    asked: list[str] = []
    layout = SimpleNamespace(column=lambda **k: layout, label=lambda text, icon: asked.append(text))
    operator = SimpleNamespace(overwrite=True, layout=layout)
    operator.lines = operators.Train.confirm_lines(operator, bpy.context)
    operators.Train.draw(operator, bpy.context)
    text = " ".join(asked).replace("- ", "-")  # a path is broken at its hyphens too
    assert f"{folder} (3,000 steps, written 2023-11-14" in text
    assert settings.result.name in text and "10 splats" in text
    settings.result.data.attributes["position"].data[3].vector = (9, 9, 9)
    (sentence,) = start_training.replaced(two.scene)[1:]
    assert settings.result.name in sentence and "edited and is kept" in sentence
    operator.overwrite = False
    assert operators.Train.confirm_lines(operator, bpy.context) == []


def test_the_run_of_another_capture_is_never_replaced(two: SimpleNamespace) -> None:
    """Neither by Start Over nor by Resume, if the output is set by hand to its folder."""
    trained(two, two.plush, splats(10))
    settings, folder = two.scene.gscore, output_folder(two.scene)
    plush, before = settings.result, contents(folder)
    settings.capture_path = str(two.studio)
    settings.output_path = str(folder)
    calls = [
        lambda: start_training.train(two.scene, overwrite=True),
        lambda: start_training.train(two.scene),
    ]
    calls += [lambda: start_training.resume(two.scene), lambda: start_training.replaced(two.scene)]
    for call in calls:
        with pytest.raises(ValueError, match=r"run of another capture, .*plush") as caught:
            call()
        assert str(folder) in str(caught.value) and "3,000 steps" in str(caught.value)
    facts.run(two.scene)
    until(lambda: facts.run(two.scene)[0] is not None)
    assert facts.run(two.scene)[0].foreign
    assert contents(folder) == before and len(plush.data.vertices) == 10
    link = two.tmp / "link"
    link.symlink_to(two.plush)
    settings.capture_path, settings.output_path = str(link), str(folder)
    assert "3,000 steps" in start_training.replaced(two.scene)[0], "a link means the same capture"


def test_an_object_whose_folder_is_gone_is_kept(two: SimpleNamespace) -> None:
    """It is the only copy: trainings of another capture, and of the same, make new objects.

    No dialog named it, because there was no run to replace.
    """
    first = splats(10, 1)
    trained(two, two.plush, first)
    settings, folder = two.scene.gscore, output_folder(two.scene)
    plush = settings.result
    shutil.rmtree(folder)
    trained(two, two.plush, splats(15, 3))
    again = settings.result
    assert again is not plush
    shutil.rmtree(folder)
    settings.capture_path = str(two.studio)
    settings.output_path, settings.result = str(folder), again
    write_splats(two.tmp / "s.ply", splats(20, 2))
    run(two, finish(str(two.tmp / "s.ply")))
    start_training.train(two.scene, overwrite=True, wait=True)
    assert settings.result not in (plush, again)
    np.testing.assert_array_equal(positions(plush), first.means)
    assert (len(again.data.vertices), len(settings.result.data.vertices)) == (15, 20)


def test_splats_arrive_where_their_capture_is(two: SimpleNamespace) -> None:
    """Snapshots and result of plush, after studio was chosen, go to plush's object only."""
    settings = two.scene.gscore
    settings.capture_path = str(two.plush)
    for name, count in (("a", 10), ("b", 20), ("r", 30)):
        write_splats(two.tmp / f"{name}.ply", splats(count))
    shots = [{"event": "snapshot", "step": n, "splats": 1} for n in (1, 2)]
    say = [{"say": s | {"path": str(two.tmp / f"{n}.ply")}} for s, n in zip(shots, "ab", strict=1)]
    ways = [say[0], {"await": "go"}, say[1], {"await": "go"}]
    run(two, *ways, finish(str(two.tmp / "r.ply")))
    job = start_training.train(two.scene)
    until(lambda: settings.result is not None)
    plush = settings.result
    settings.capture_path = str(two.studio)
    assert start_training.job_of(two.scene) is None
    job._process.send("go")
    until(lambda: len(plush.data.vertices) == 20)
    job._process.send("go")
    assert start_training.wait_for(job, timeout=20)
    assert len(plush.data.vertices) == 30 and settings.result is None
    settings.capture_path = str(two.plush)
    assert settings.result == plush and start_training.job_of(two.scene) is job


def test_discarding_a_new_start_keeps_the_old_object(two: SimpleNamespace) -> None:
    """Until the new run has filled it, because it has the only splats of the old run."""
    trained(two, two.plush, splats(10))
    plush = two.scene.gscore.result
    run(two, step(1), {"sleep": 600})
    job = start_training.train(two.scene, overwrite=True)
    until(lambda: job.state.step == 1)
    start_training.discard(job)
    until(lambda: job.state.ended)
    for _ in range(20):
        poll_timer.poll()
    assert two.scene.gscore.result == plush and len(plush.data.vertices) == 10


def test_captures_of_the_same_name_get_folders_of_their_own(two: SimpleNamespace) -> None:
    """Otherwise both would be next to the saved file, also in two scenes."""
    other = two.tmp / "elsewhere" / "plush"
    shutil.copytree(STUDIO, other)
    bpy.ops.wm.save_as_mainfile(filepath=str(two.tmp / "a.blend"))
    trained(two, two.plush, splats(10))
    assert output_folder(two.scene) == two.tmp / "splats" / "plush"
    two.scene.gscore.capture_path = str(other)
    assert output_folder(two.scene) == two.tmp / "splats" / "plush-2"
    second = bpy.data.scenes.new("second")
    second.gscore.capture_path = str(other)
    assert output_folder(second) == two.tmp / "splats" / "plush-2"
    second.gscore.capture_path = str(two.plush)
    assert output_folder(second) == two.tmp / "splats" / "plush"


def test_of_two_scenes_the_one_that_trained_gets_the_splats(two: SimpleNamespace) -> None:
    """A copy of a scene has the same capture and output."""
    two.scene.gscore.capture_path = str(two.plush)
    two.scene.gscore.output_path = str(two.tmp / "out")
    copy = two.scene.copy()
    write_splats(two.tmp / "r.ply", splats(10))
    run(two, finish(str(two.tmp / "r.ply")))
    start_training.train(copy, wait=True)
    assert two.scene.gscore.result is None and len(copy.gscore.result.data.vertices) == 10


def test_outcomes_move_with_the_file(two: SimpleNamespace) -> None:
    """Relative paths of the capture that is not chosen, after saving elsewhere and moving all."""
    settings, here, there = two.scene.gscore, two.tmp / "here", two.tmp / "there"
    for name in ("plush", "studio"):
        (here / "shots").mkdir(parents=True, exist_ok=True)
        shutil.move(two.tmp / name, here / "shots" / name)
    settings.capture_path = str(here / "shots" / "plush")
    settings.output_path = str(here / "runs" / "plush")
    settings.capture_path = str(here / "shots" / "studio")
    bpy.ops.wm.save_as_mainfile(filepath=str(here / "a.blend"))
    bpy.ops.wm.save_as_mainfile(filepath=str(here / "shots" / "b.blend"))
    here.rename(there)
    bpy.ops.wm.open_mainfile(filepath=str(there / "shots" / "b.blend"))
    settings = bpy.context.scene.gscore
    assert settings.capture_path == settings.outcome_of == "//studio"
    settings.capture_path = "//plush"
    assert output_folder(bpy.context.scene) == there / "runs" / "plush"


def test_a_capture_that_has_moved_keeps_its_outcome(two: SimpleNamespace) -> None:
    """Its old folder is missing; another capture, whose folder exists, does not get it."""
    settings = two.scene.gscore
    settings.capture_path, settings.output_path = str(two.plush), str(two.tmp / "out")
    moved = two.plush.rename(two.tmp / "moved")
    settings.capture_path = str(moved)
    assert settings.output_path == str(two.tmp / "out")
    settings.capture_path = ""
    settings.capture_path = str(two.studio)
    assert settings.output_path == ""


def test_the_sidebar_is_about_the_chosen_capture(two: SimpleNamespace) -> None:
    """Its empty, whichever was imported first; a second one can be imported at another place."""
    settings = two.scene.gscore
    settings.capture_path = str(two.plush)
    bpy.ops.gscore.import_cameras()
    plush = panel_root(two.scene)
    settings.capture_path = str(two.studio)
    assert panel_root(two.scene) is None
    bpy.ops.gscore.import_cameras()
    studio = panel_root(two.scene)
    assert studio not in (None, plush)
    places = [Path(stored_paths.read(ob, stored_paths.SOURCE)) for ob in (plush, studio)]
    assert places == [two.plush, two.studio]
    bpy.context.view_layer.objects.active = None
    two.scene.camera = None
    assert find_root(bpy.context) == studio
    settings.capture_path = str(two.plush)
    assert (panel_root(two.scene), find_root(bpy.context)) == (plush, plush)


def test_resume_goes_on_in_the_same_object(two: SimpleNamespace) -> None:
    """The run's capture may have moved since: its path in the run counts too."""
    trained(two, two.plush, splats(10))
    settings = two.scene.gscore
    plush = settings.result
    moved = two.plush.rename(two.tmp / "moved")
    settings.capture_path = str(moved)
    settings.iterations = 4000
    write_splats(two.tmp / "r.ply", splats(30))
    run(two, finish(str(two.tmp / "r.ply")))
    start_training.resume(two.scene, wait=True)
    arguments = json.loads((two.tmp / "p" / "script.args").read_text())
    assert arguments[4] == str(moved)
    assert settings.result == plush and len(plush.data.vertices) == 30


def test_captures_are_listed_and_chosen(two: SimpleNamespace) -> None:
    """Oracle: the folders; a menu appears with the second capture, and switches to its splats."""
    scene = two.scene
    assert operators.known(scene) == [] and "[menu" not in drawn(CapturePanel)
    trained(two, two.plush, splats(20))
    first = scene.gscore.result
    assert operators.known(scene) == [two.plush] and "[menu" not in drawn(CapturePanel)
    scene.gscore.capture_path = str(two.studio / "sparse" / "0")
    bpy.ops.gscore.import_cameras(directory=str(two.studio), photos=False)
    assert operators.known(scene) == [two.plush, two.studio]
    assert "[menu: (plush) (studio)]" in drawn(CapturePanel)
    assert bpy.ops.gscore.choose_capture(path=str(two.plush)) == {"FINISHED"}
    assert scene.gscore.result == first and panel_root(scene) is None
    assert "is given" in error_of(bpy.ops.gscore.choose_capture)


def test_captures_of_one_name_are_distinguished(two: SimpleNamespace) -> None:
    """Oracle: only cameras of the chosen folder, until the other is missing, because it has
    moved."""
    other = two.tmp / "elsewhere" / "plush"
    shutil.copytree(STUDIO, other)
    bpy.ops.gscore.import_cameras(directory=str(two.plush), photos=False)
    root = panel_root(two.scene)
    two.scene.gscore.capture_path = str(other)
    assert root is not None and panel_root(two.scene) is None
    assert operators.label(other, operators.known(two.scene)) == f"plush ({other.parent})"
    shutil.rmtree(two.plush)
    assert panel_root(two.scene) == root
