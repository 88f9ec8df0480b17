"""Oracle: the scene after a scripted `gscore sfm`, the real one's files, and the panels' text."""

import json
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy
import pytest

from addon import preferences
from addon.cameras import importing
from addon.cameras.lookup import chosen_root
from addon.cameras.objects import cameras_of, points_of
from addon.core import FramesDone
from addon.interface import incremental_removal
from addon.panels.cameras import CapturePanel
from addon.panels.progress import ProgressPanel
from addon.panels.train import TrainPanel
from addon.sfm import find_cameras
from addon.training import facts, start_training, verb_job, verb_jobs
from tests.addon.captures import STUDIO
from tests.addon.drawn import drawn
from tests.addon.trainings import until

REAL = os.environ.get("GSCORE_TRAINER_PYTHON", "")
needs_trainer = pytest.mark.skipif(not REAL, reason="GSCORE_TRAINER_PYTHON names no Python")
Play = Callable[..., Path]
NEAR = (0, 1, 2, 19, 20, 21, 39, 40)
FRAMES = {"event": "frames_progress", "phase": "looking at frames", "done": 30, "total": 120}
TAKEN = {"event": "frames", "frames": 40, "total": 120, "blurred": 3, "repeated": 1}
STEP = {"event": "sfm_progress", "phase": "finding features", "done": 10, "total": 40}
DONE = {"event": "sfm", "photos": 8, "registered": 7, "models": 1, "points": 1234}
DONE |= {"reprojection_px": 0.456, "seconds": 9.0, "path": "p"}


@pytest.fixture
def holiday(scene: bpy.types.Scene, tmp_path: Path, no_work: None) -> bpy.types.Scene:
    """A scene whose capture is a folder of plain photos."""
    folder = tmp_path / "holiday"
    folder.mkdir()
    for i in NEAR:
        shutil.copy(STUDIO / f"images/view_{i:03}.jpg", folder)
    scene.gscore.capture_path = str(folder)
    facts.refresh(scene)
    return scene


def _made(capture: Path) -> list[dict]:
    """Steps of a script that write the studio's model to a capture."""
    model = STUDIO / "sparse" / "0"
    for file in model.iterdir():
        target = capture.parent / "waiting" / "sparse" / "0" / file.name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(file, target)
    return [{"await": "go"}, {"say": DONE}]


def test_from_button_to_cameras(holiday: bpy.types.Scene, tmp_path: Path, play: Play) -> None:
    """Oracle: the command line, the script's events, and Blender's objects at the end."""
    capture = tmp_path / "holiday-capture"
    called = play({"say": STEP | {"eta_s": 9.0, "left_s": 75.0}}, *_made(capture))
    assert "Photos without cameras" in drawn(CapturePanel) and "(Find Cameras)" in drawn(
        CapturePanel
    )
    assert "Find the cameras first" in drawn(TrainPanel)
    with pytest.raises(RuntimeError, match="press Find Cameras first"):
        bpy.ops.gscore.train()

    assert bpy.ops.gscore.find_cameras() == {"FINISHED"}
    job = find_cameras.job_of(holiday)
    until(lambda: job.progress is not None)
    shown = drawn(ProgressPanel)
    assert "[25%] Finding features, 1:15 left" in shown and "()" in shown and "10 / 40" in shown
    assert "see Progress" in drawn(CapturePanel)
    with pytest.raises(RuntimeError, match="is running already"):
        bpy.ops.gscore.find_cameras()

    (tmp_path / "waiting").rename(capture)
    job._process.send("go")
    until(lambda: job.ended and not job.awaits_import)
    words = json.loads(called.read_text())
    assert words[words.index("sfm") :][:4] == ["sfm", str(tmp_path / "holiday"), "-o", str(capture)]
    assert holiday.gscore.capture_path == str(capture)
    root = chosen_root(holiday)
    assert len(cameras_of(root)) == 60 and points_of(root) is not None
    assert "7 of 8 photos have a camera; the others are left out" in drawn(ProgressPanel)


def test_a_video_takes_frames_first(holiday: bpy.types.Scene, tmp_path: Path, play: Play) -> None:
    """Oracle: the script's events, and the folder name next to the video."""
    (tmp_path / "walk.mp4").write_bytes(b"not looked into here")
    called = play({"say": FRAMES | {"eta_s": 5.0}}, {"await": "go"},
                  {"say": TAKEN | {"seconds": 1.0, "path": "p"}}, {"await": "stop"})  # fmt: skip
    assert bpy.ops.gscore.choose_video(filepath=str(tmp_path / "walk.mp4")) == {"FINISHED"}
    facts.refresh(holiday)
    assert "A video without cameras" in drawn(CapturePanel)
    bpy.ops.gscore.find_cameras()
    job = find_cameras.job_of(holiday)
    until(lambda: job.progress is not None)
    assert "[25%] Looking at frames, 0:05 left" in drawn(ProgressPanel)
    job._process.send("go")
    until(lambda: job.last(FramesDone) is not None)
    assert "40 of 120" in drawn(ProgressPanel)
    assert str(tmp_path / "walk-capture") in called.read_text()

    assert bpy.ops.gscore.cancel_search() == {"FINISHED"}
    assert "Ending" in drawn(ProgressPanel)
    until(lambda: job.ended)
    assert job.status == verb_job.CANCELLED and "continues from there" in drawn(ProgressPanel)
    assert "(Find Cameras)" in drawn(CapturePanel)
    with pytest.raises(RuntimeError, match="No search for cameras is running"):
        bpy.ops.gscore.cancel_search()


@pytest.mark.parametrize("late", ["cancelled", "found", "again"])
def test_a_search_follows_one_that_is_ending(
    holiday: bpy.types.Scene, tmp_path: Path, play: Play, late: str
) -> None:
    """Oracle: the panel, and processes that end some time after Cancel: never two at a time.
    Results of the first are still imported, and a waiting search can be cancelled too."""
    capture = tmp_path / "holiday-capture"
    ending = _made(capture) if late == "found" else [{"await": "go"}]
    play({"say": STEP | {"eta_s": 9.0}}, {"await": "stop"}, *ending)
    bpy.ops.gscore.find_cameras()
    first = find_cameras.job_of(holiday)
    until(lambda: first.progress is not None)
    bpy.ops.gscore.cancel_search()
    assert "(Find Cameras)" in drawn(CapturePanel)
    assert bpy.ops.gscore.find_cameras() == {"FINISHED"}
    second = find_cameras.job_of(holiday)
    assert second is not first and second._process is None and not first.ended
    assert "see Progress" in drawn(CapturePanel)
    if late == "again":
        bpy.ops.gscore.cancel_search()
    if late == "found":
        (tmp_path / "waiting").rename(capture)
    first._process.send("go")
    until(lambda: first.ended)
    if late == "cancelled":
        until(lambda: second.progress is not None)
        assert second._process.pid != first._process.pid
        bpy.ops.gscore.cancel_search()
        second._process.send("go")
    until(lambda: second.ended and not second.awaits_import)
    found = late == "found"
    assert second.status == (verb_job.FINISHED if found else verb_job.CANCELLED)
    assert (second._process is None) is (late != "cancelled")
    assert (chosen_root(holiday) is not None) is found


def test_a_package_that_is_missing(holiday: bpy.types.Scene, tmp_path: Path, play: Play) -> None:
    """Oracle: gscore's message, and the add-on's way to get the package."""
    message = 'Reading a video needs the package av; install it with: pip install "gscore[video]".'
    error = {"event": "error", "message": message, "type": "BackendError", "package": "av"}
    play({"say": error}, {"exit": 2})
    with pytest.raises(RuntimeError, match="Make Environment in the add-on's preferences"):
        bpy.ops.gscore.find_cameras(wait=True)
    assert "needs the package av" in drawn(ProgressPanel)
    folder = Path(find_cameras.__file__).parents[1] / "trainer_python/pinned"
    pins = (folder / "packages.txt").read_text()
    assert "==" in pins
    assert "\nav==" in pins and "\nhuggingface-hub==" in pins


@pytest.mark.parametrize("shown", [False, True])
def test_cameras_come_into_the_scene_that_asked(
    holiday: bpy.types.Scene, tmp_path: Path, play: Play, monkeypatch: pytest.MonkeyPatch, shown
) -> None:
    """Another scene is in the window, or this one. Oracle: the objects, selection and settings of
    both; no context override, which can crash Blender with running threads."""
    monkeypatch.setattr(bpy.types.Context, "temp_override", None)
    other, window = bpy.data.scenes.new("Other"), bpy.context.window_manager.windows[0]
    capture = tmp_path / "holiday-capture"
    play(*_made(capture))
    bpy.ops.gscore.find_cameras()
    job = find_cameras.job_of(holiday)
    try:
        if not shown:
            window.scene = other
        (tmp_path / "waiting").rename(capture)
        job._process.send("go")
        until(lambda: job.ended and not job.awaits_import)
        root, layer = chosen_root(holiday), holiday.view_layers[0]
        assert len(cameras_of(root)) == 60 and not other.objects and not other.gscore.capture_path
        assert layer.objects.active == root
        assert [ob for ob in layer.objects if ob.select_get(view_layer=layer)] == [root]
        assert not any("Error" in text for text in job.warnings)
    finally:
        window.scene = holiday
        bpy.data.scenes.remove(other)


def test_another_capture_chosen_meanwhile_stays(
    holiday: bpy.types.Scene, tmp_path: Path, play: Play
) -> None:
    """Oracle: the settings and objects of the scene."""
    capture = tmp_path / "holiday-capture"
    play(*_made(capture))
    bpy.ops.gscore.find_cameras()
    job = find_cameras.job_of(holiday)
    holiday.gscore.capture_path = str(STUDIO)
    (tmp_path / "waiting").rename(capture)
    job._process.send("go")
    until(lambda: job.ended and not job.awaits_import)
    assert holiday.gscore.capture_path == str(STUDIO) and not holiday.objects


@pytest.mark.parametrize("by", ["another capture", "another file"])
def test_changes_during_the_camera_import(
    holiday: bpy.types.Scene, tmp_path: Path, play: Play, monkeypatch: pytest.MonkeyPatch, by: str
) -> None:
    """Oracle: the scene's objects and its capture; no data of the import are left."""
    monkeypatch.setattr(importing, "BUDGET", 0.0)
    capture = tmp_path / "holiday-capture"
    play(*_made(capture))
    bpy.ops.gscore.find_cameras()
    job = find_cameras.job_of(holiday)
    (tmp_path / "waiting").rename(capture)
    job._process.send("go")
    until(lambda: len(bpy.data.cameras) > 10)
    if by == "another file":
        bpy.ops.wm.read_homefile(use_empty=True)
    else:
        holiday.gscore.capture_path = str(STUDIO)
    until(lambda: not job.awaits_import)
    incremental_removal.finish()
    scene = bpy.context.scene
    assert not scene.objects and not bpy.data.cameras and not bpy.data.collections
    assert scene.gscore.capture_path == ("" if by == "another file" else str(STUDIO))
    assert job.import_task is None and "gone" not in " ".join(job.warnings)


@pytest.mark.parametrize("error", [MemoryError(), KeyError("ours")])
def test_cameras_that_fail_to_come_are_not_tried_again(
    holiday: bpy.types.Scene, play: Play, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    """Oracle: a message without memory, else the error itself, once."""

    def fails(*_: object, **__: object) -> Iterator[str]:
        yield "begun"
        raise error

    play({"say": DONE})
    bpy.ops.gscore.find_cameras()
    job = find_cameras.job_of(holiday)
    while not job.ended:
        job.poll()
    monkeypatch.setattr(find_cameras, "importing", fails)
    monkeypatch.setattr(find_cameras, "job_of", lambda scene: job)
    assert not verb_jobs.import_next(job)
    if isinstance(error, MemoryError):
        assert verb_jobs.import_next(job)
        assert "not enough memory" in job.warnings[0]
    else:
        with pytest.raises(KeyError, match="ours"):
            verb_jobs.import_next(job)
    assert job.import_task is None and not verb_jobs.import_next(job)


def test_unsearchable_sources_are_refused(
    holiday: bpy.types.Scene, tmp_path: Path, play: Play
) -> None:
    """Oracle: an error for each; no process is started."""
    called = play({"say": DONE})
    for photo in list((tmp_path / "holiday").iterdir())[2:]:
        photo.unlink()
    facts.refresh(holiday)
    assert "at least 3 that overlap are needed" in drawn(CapturePanel)
    with pytest.raises(RuntimeError, match="at least 3 that overlap"):
        bpy.ops.gscore.find_cameras()
    holiday.gscore.capture_path = str(STUDIO)
    with pytest.raises(RuntimeError, match="is neither a folder of photos without cameras"):
        bpy.ops.gscore.find_cameras()
    with pytest.raises(RuntimeError, match="There is no video"):
        bpy.ops.gscore.choose_video(filepath=str(tmp_path / "gone.mp4"))
    with pytest.raises(RuntimeError, match="No video is chosen"):
        bpy.ops.gscore.choose_video()
    assert not called.exists()


@pytest.mark.skipif(not hasattr(bpy.types, "FileHandler"), reason="this Blender takes no drops")
def test_videos_can_be_dropped() -> None:
    """Oracle: the handlers registered in Blender."""
    handler = bpy.types.GSCORE_FH_video
    assert ".mp4" in handler.bl_file_extensions.split(";")
    operator = bpy.ops.gscore.choose_video.get_rna_type()
    assert handler.bl_import_operator == "gscore.choose_video"
    assert {"filepath", "directory"} <= set(operator.properties.keys())


FILM = """
import av, numpy as np, sys
from PIL import Image
from pathlib import Path
photos = sorted(Path(sys.argv[1]).glob("*.jpg"))[:20]
with av.open(sys.argv[2], "w") as file:
    stream = file.add_stream("libx264", rate=4, options={"crf": "12"})
    stream.width, stream.height, stream.pix_fmt = *Image.open(photos[0]).size, "yuv420p"
    for photo in photos:
        picture = Image.open(photo)
        frame = av.VideoFrame.from_ndarray(np.array(picture.convert("RGB")), format="rgb24")
        file.mux(stream.encode(frame))
    file.mux(stream.encode())
"""


@needs_trainer
@pytest.mark.slow
def test_three_clicks_from_a_video_to_splats(holiday: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: the real programs; splats in the scene, upright below the capture's empty."""
    film = tmp_path / "walk.mp4"
    subprocess.run([REAL, "-c", FILM, str(STUDIO / "images"), str(film)], check=True)
    preferences.get().python_path = REAL
    holiday.gscore.preset = "preview"
    bpy.ops.gscore.choose_video(filepath=str(film))
    assert bpy.ops.gscore.find_cameras(wait=True) == {"FINISHED"}
    assert len(cameras_of(chosen_root(holiday))) >= 10
    holiday.gscore.iterations = 60
    facts.refresh(holiday)
    job = start_training.train(holiday, wait=True)
    assert job.state.result is not None
    assert len(holiday.gscore.result.data.vertices) > 100

    holiday.gscore.capture_path = str(film)
    assert bpy.ops.gscore.find_cameras() == {"FINISHED"}  # found before
    assert holiday.gscore.capture_path == str(tmp_path / "walk-capture")
