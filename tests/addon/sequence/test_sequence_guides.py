"""Guide meshes of a sequence. Oracle: the files passed to the trainer, compared with the meshes of
the scene at the frames of the timeline, and the real trainer's output."""

import json
from pathlib import Path

import bpy
import numpy as np
import plyfile
import pytest

from addon import preferences
from addon.cameras.objects import cameras_of
from addon.panels.train import GuidesPanel, TrainSequencePanel
from addon.sequence import train_sequence
from addon.training import guides
from gscore.datasets.frames import of_frame
from tests.addon.drawn import drawn
from tests.addon.sequence.test_train_sequence import (  # noqa: F401 - fixtures
    DONE,
    Play,
    needs_trainer,
    panel,
    two_real_frames,
    video,
)


def a_wall(scene: bpy.types.Scene, name: str = "Wall") -> bpy.types.Object:
    """A square in a guide collection."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [], [(0, 1, 2, 3)])
    ob = bpy.data.objects.new(name, mesh)
    scene.collection.objects.link(ob)
    guides.add_to_guides(scene, "surface", [ob])
    bpy.context.view_layer.update()
    return ob


def corners(path: Path) -> np.ndarray:
    """[V, 3] of a file."""
    vertex = plyfile.PlyData.read(path)["vertex"]
    return np.stack([vertex[axis] for axis in "xyz"], axis=1)


def reported(called: Path) -> Path:
    """The trainer's option for the surface mesh."""
    words = json.loads(called.read_text())
    return Path(words[words.index("--guide-surface") + 1])


def bring_first(scene: bpy.types.Scene, tmp_path: Path) -> bpy.types.Object:
    """Import the cameras of the first frame, upright."""
    bpy.ops.gscore.import_cameras(directory=str(tmp_path / "video" / "000000"), photos=False)
    return next(ob for ob in scene.objects if ob.type == "EMPTY")


@pytest.fixture
def wall(video: bpy.types.Scene, tmp_path: Path) -> bpy.types.Object:  # noqa: F811
    """A guide wall, and the cameras of the first frame."""
    ob = a_wall(video)
    bring_first(video, tmp_path)
    return ob


def test_meshes_that_move_are_written_at_each_frame(
    video: bpy.types.Scene,  # noqa: F811
    tmp_path: Path,
    play: Play,
) -> None:
    """Frames 0, 4 and 12 are 11, 12 and 14 of the timeline; the scene's frame does not change."""
    ob = a_wall(video)
    video.frame_set(7)
    text = panel()
    assert "need the cameras of frame 0" in text and "(Import Frame 0)" in text
    assert "Import the cameras" not in drawn(GuidesPanel)
    called = play({"say": DONE})
    with pytest.raises(RuntimeError, match="import the cameras of frame 0 first"):
        bpy.ops.gscore.train_sequence()
    assert not train_sequence.is_started(train_sequence.output_of(video))
    root = bring_first(video, tmp_path)
    assert len(cameras_of(root)) == 60
    text = drawn(TrainSequencePanel)
    assert "need the cameras of frame 0" not in text and "<guide_start>" in text
    for frame in (11, 14):
        ob.location.x = 0.1 * frame
        ob.keyframe_insert("location", frame=frame)
        ob.data.shape_keys or ob.shape_key_add(name="Basis")
    bent = ob.shape_key_add(name="Bent")
    bent.data[0].co.z = 1.0
    for frame, value in ((11, 0.0), (14, 1.0)):
        bent.value = value
        bent.keyframe_insert("value", frame=frame)
    own = video.gscore_train_sequence
    own.guide_start, own.frames = 11, "0,4,12"
    bpy.ops.gscore.train_sequence(wait=True)
    assert video.frame_current == 7
    pattern = reported(called)
    assert pattern.parent == train_sequence.output_of(video) / "guides"
    files = sorted(pattern.parent.iterdir())
    assert [path.name for path in files] == [
        pattern.name.replace("{frame:06d}", f"{n:06d}") for n in (0, 4, 12)
    ]
    for path, frame in zip(files, (11, 12, 14), strict=True):
        video.frame_set(frame)
        graph = bpy.context.evaluated_depsgraph_get()
        seen = ob.evaluated_get(graph)
        to_capture = root.matrix_world.inverted() @ seen.matrix_world
        wanted = [tuple(to_capture @ v.co) for v in seen.data.vertices]
        np.testing.assert_allclose(corners(path), wanted, atol=1e-5)
    assert not np.allclose(corners(files[0]), corners(files[1]), atol=0.01)


def test_meshes_that_stand_still_are_one_file(
    wall: bpy.types.Object,
    video: bpy.types.Scene,  # noqa: F811
    play: Play,
) -> None:
    """Oracle: the file; another shape replaces it; resuming passes none."""
    called = play({"say": DONE})
    panel()
    bpy.ops.gscore.train_sequence(wait=True)
    first = reported(called)
    assert first.is_file() and [first] == list(first.parent.iterdir())
    mine = first.with_name("surface-mine.ply")
    mine.touch()
    wall.data.vertices[0].co.x = 3
    wall.data.update()
    bpy.ops.gscore.train_sequence(overwrite=True, wait=True)
    assert reported(called) != first and {reported(called), mine} == set(first.parent.iterdir())
    (train_sequence.output_of(video) / "sequence.json").write_text("{}")
    bpy.ops.gscore.train_sequence(resume=True, wait=True)
    assert "--guide-surface" not in json.loads(called.read_text())


def test_meshes_of_a_sequence_stay_until_another_begins(
    wall: bpy.types.Object,
    video: bpy.types.Scene,  # noqa: F811
    tmp_path: Path,
    play: Play,
) -> None:
    """Oracle: the files, after Start Over without a working Python, with a trainer that fails its
    checks, and with one that trains."""
    for frame in (1, 4):
        wall.location.x = 0.1 * frame
        wall.keyframe_insert("location", frame=frame)
    called = play({"say": DONE})
    panel()
    bpy.ops.gscore.train_sequence(wait=True)
    folder = reported(called).parent
    before = set(folder.iterdir())
    assert len(before) == 4
    python = tmp_path / "python that cannot be run"
    python.touch(mode=0o600)
    preferences.get().python_path = str(python)
    with pytest.raises(ValueError, match="cannot be run"):
        train_sequence.train_sequence(video, overwrite=True)
    assert before < set(folder.iterdir())
    refused = {"event": "error", "type": "ConfigError", "message": "No such mesh."}
    play({"say": refused}, {"exit": 2})
    with pytest.raises(RuntimeError, match="No such mesh"):
        bpy.ops.gscore.train_sequence(overwrite=True, wait=True)
    assert before < set(folder.iterdir())
    play({"say": DONE})
    bpy.ops.gscore.train_sequence(overwrite=True, wait=True)
    after = set(folder.iterdir())
    assert len(after) == 4 and not after & before


@pytest.mark.parametrize("moves", [False, True])
def test_folders_of_results_may_hold_braces(
    wall: bpy.types.Object,
    video: bpy.types.Scene,  # noqa: F811
    tmp_path: Path,
    play: Play,
    moves: bool,
) -> None:
    """Oracle: gscore's value of the option for each frame, and the existing files."""
    for frame in (1, 4) if moves else ():
        wall.location.x = 0.1 * frame
        wall.keyframe_insert("location", frame=frame)
    video.gscore.output_path = str(tmp_path / "a {b} }c{ {frame}" / "out")
    called = play({"say": DONE})
    panel()
    bpy.ops.gscore.train_sequence(wait=True)
    files = {of_frame(reported(called), number) for number in (0, 4, 8, 12)}
    folder = train_sequence.output_of(video) / "guides"
    assert files == set(folder.iterdir()) and len(files) == (4 if moves else 1)


def test_unsupported_parts_are_reported(
    video: bpy.types.Scene,  # noqa: F811
    tmp_path: Path,
    play: Play,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Oracle: messages about a hidden mesh, one that is missing at a frame, and Limit to Object."""
    play({"say": DONE})
    ob, hidden = a_wall(video), a_wall(video, "Hidden")
    hidden.hide_set(True)
    bring_first(video, tmp_path)
    box = bpy.data.objects.new("Box", None)
    video.collection.objects.link(box)
    video.gscore.train_within = box
    assert "Limit to Object (Box) is only for single" in panel()
    lines = train_sequence.unsupported_parts(video)
    assert (
        "Limit to Object (Box) is only for single" in lines[0] and "Hidden in Guide Sur" in lines[1]
    )
    for frame, value in ((1, False), (3, True)):
        ob.hide_viewport = value
        ob.keyframe_insert("hide_viewport", frame=frame)
    video.frame_set(1)
    with pytest.raises(
        RuntimeError, match=r"At frame 3 of the timeline, for frame 8 of the sequence: Guide Surf"
    ):
        bpy.ops.gscore.train_sequence()
    assert video.frame_current == 1
    assert "Limit to Object (Box)" in capfd.readouterr().out


@needs_trainer
@pytest.mark.slow
def test_a_real_sequence_is_guided(video: bpy.types.Scene, tmp_path: Path) -> None:  # noqa: F811
    """Oracle: config.json of each frame, and files that the trainer has read."""
    two_real_frames(video, tmp_path)
    bring_first(video, tmp_path)
    ob = a_wall(video)
    for frame, height in ((1, 0.0), (2, 0.2)):
        ob.location.z = height
        ob.keyframe_insert("location", frame=frame)
    panel()
    bpy.ops.gscore.train_sequence(wait=True)
    assert train_sequence.job_of(video).sentence.startswith("2 frames are complete")
    output, names = train_sequence.output_of(video), []
    for number in (0, 4):
        options = json.loads((output / f"frame_{number:06d}" / "config.json").read_text())
        names.append(Path(options["train"]["guide_surface"]))
    assert names[0] != names[1] and all(path.is_file() for path in names)
    asked = json.loads((output / "config.json").read_text())["train"]["guide_surface"]
    assert asked.endswith("-{frame:06d}.ply")
