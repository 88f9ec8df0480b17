"""Sequences on Blender's timeline. Oracle, unless stated otherwise: the files of the frames."""

import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bmesh
import bpy
import numpy as np
import pytest

from addon.core import GsError, Splats, read_splats, sh0_to_rgb, write_splats
from addon.panels.result import SequencePanel
from addon.process import poll_timer
from addon.process.incremental_tasks import TaskRunner
from addon.render.engine import final_cache
from addon.render.scene import sources
from addon.render.viewport_copies import Copies
from addon.splats import objects
from addon.timeline import frame_sync, mesh, operators
from addon.timeline.frames import Series
from addon.timeline.library import LIBRARY
from tests.addon import points
from tests.addon import splat_scenes as lab
from tests.addon.calls import import_sequence
from tests.addon.drawn import drawn

SIZE = (90, 70)


def frame_splats(number: int) -> Splats:
    """Different splats for each frame: other positions, counts and degrees."""
    splats = lab.blob(300 + 10 * number, seed=number)
    if number % 2:
        return splats
    names = ("means", "quats", "scales", "opacities", "sh0")
    plain = {name: getattr(splats, name) for name in names}
    return Splats(**plain, shN=np.zeros((len(splats), 0, 3), np.float32))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Frames 0 to 5 as PLY."""
    for number in range(6):
        write_splats(tmp_path / "frames" / f"frame_{number:04d}.ply", frame_splats(number))
    return tmp_path / "frames"


@pytest.fixture
def playing(scene, folder) -> bpy.types.Object:
    """The sequence at frames 1 to 6 of the timeline, in front of a camera."""
    lab.prepare(scene, SIZE)
    return play(folder)


def play(folder: Path, **options) -> bpy.types.Object:
    """Import by the operator."""
    assert bpy.ops.gscore.import_sequence(directory=str(folder), up="Z", **options) == {"FINISHED"}
    return bpy.context.object


def number_of(ob: bpy.types.Object) -> int:
    """The frame in an object's mesh, identified by its number of splats."""
    return (len(ob.data.vertices) - 300) // 10


def shown() -> list[tuple[int, np.ndarray]]:
    """Number and means of the splats that the add-on's renderers draw."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    parts = final_cache.parts(copied(depsgraph))
    return [(len(p), p.means) for p in parts]


def copied(depsgraph: bpy.types.Depsgraph) -> list:
    """The splats that a viewport would draw, once all are read."""
    made = Copies()
    until = time.monotonic() + 60
    while True:
        found = sources(depsgraph)
        placed, complete = made.copied(found)
        assert not made.under_way(found)  # no view is redrawn repeatedly for a file
        if complete:
            return placed
        assert time.monotonic() < until
        time.sleep(0.005)


def until(condition: Callable[[], bool]) -> None:
    """Poll until a condition is true."""
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end
        poll_timer.poll()
        time.sleep(0.005)


def test_one_object_plays_the_folder(scene, playing) -> None:
    """The mesh has the splats of each file, attribute by attribute, and the add-on's renderers draw
    them."""
    splat_objects = [ob for ob in scene.objects if objects.is_splats(ob)]
    assert splat_objects == [playing] and playing.name == "frames"
    for frame in (1, 4, 2, 6):
        scene.frame_set(frame)
        own, file = objects.read(playing), frame_splats(frame - 1)
        np.testing.assert_array_equal(own.means, file.means)
        np.testing.assert_array_equal(own.sh0, file.sh0)
        np.testing.assert_array_equal(own.shN, file.shN)
        np.testing.assert_array_equal(shown()[0][1], file.means)


def test_pictures_of_an_animation(scene, playing, tmp_path) -> None:
    """Oracle: gscore.render of the files, for `render.render(animation=True)`."""
    scene.frame_start, scene.frame_end = 2, 4
    settings = scene.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = "PNG", "RGB", "8"
    scene.render.filepath = str(tmp_path / "out_")
    bpy.ops.render.render(animation=True)
    for frame in (2, 3, 4):
        got = lab.read_image(tmp_path / f"out_{frame:04d}.png")
        want = lab.truth(scene.camera, frame_splats(frame - 1), SIZE).rgb
        assert np.abs(got[..., :3] - np.clip(want, 0, 1)).max() <= 1.01 / 255


def test_other_engines_see_the_mesh_of_the_frame(scene, playing) -> None:
    """The evaluated mesh, which EEVEE and Cycles get."""
    scene.render.engine = "BLENDER_WORKBENCH"
    scene.frame_set(5)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert len(playing.data.evaluated_get(depsgraph).vertices) == 340
    playing.gscore_sequence.offset = 1  # the frame stays, but its content changes
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert len(playing.data.evaluated_get(depsgraph).vertices) == 350


def test_a_sequence_that_hides_is_an_empty_picture(scene, playing, tmp_path) -> None:
    """Oracle: the world's colour before the start; the first frame at it."""
    playing.gscore_sequence.start, playing.gscore_sequence.beyond = 3, "HIDE"
    scene.frame_set(2)
    empty = lab.render_file(tmp_path / "a.png")
    assert (empty[..., :3] == 0).all() and number_of(playing) == -30
    scene.frame_set(3)
    got = lab.render_file(tmp_path / "b.png")
    want = lab.truth(scene.camera, frame_splats(0), SIZE).rgb
    assert np.abs(got[..., :3] - np.clip(want, 0, 1)).max() <= 1.01 / 255


def test_copies_play_by_times_of_their_own(scene, playing) -> None:
    """Two objects that share a mesh show two frames, and each gets its own mesh."""
    other = playing.copy()
    scene.collection.objects.link(other)
    assert other.data == playing.data
    other.gscore_sequence.start = 3
    scene.frame_set(4)
    assert (number_of(playing), number_of(other)) == (3, 1)
    assert sorted(count for count, _ in shown()) == [310, 330]


def test_filters_leave_out_splats_of_each_frame(scene, playing) -> None:
    """Oracle: the sigmoid of the file's opacities."""
    playing.gscore.opacity_min = 0.6
    for frame in (2, 5):
        scene.frame_set(frame)
        logits = frame_splats(frame - 1).opacities
        assert shown()[0][0] == int((1 / (1 + np.exp(-logits)) >= 0.6).sum()) < 300


def test_gaps_are_reported_and_show_the_frame_before(scene, folder, tmp_path, capfd) -> None:
    """Oracle: the numbers of the files; a render reports them too."""
    (folder / "frame_0002.ply").unlink()
    (folder / "frame_0003.ply").unlink()
    lab.prepare(scene, SIZE)
    ob = play(folder)
    scene.frame_set(4)
    assert number_of(ob) == 1
    lab.render_file(tmp_path / "a.png")
    reported = capfd.readouterr().out
    assert "Warning: frames: Frames 2, 3 are missing; the one before is shown." in reported
    text = drawn(SequencePanel)
    assert "4: 0 to 5" in text and "Frames 2, 3 are missing" in text and "frame 1" in text


def test_a_damaged_file_ends_a_render_with_its_name(scene, playing, folder, tmp_path) -> None:
    """Oracle: the error; the mesh is unchanged, and playback continues with the next frame."""
    (folder / "frame_0003.ply").write_bytes(b"ply\nbroken")
    bpy.ops.gscore.look_at_frames_again()
    scene.frame_set(3)
    scene.frame_set(4)
    assert number_of(playing) == 2 and "frame_0003.ply" in frame_sync.problem_of(playing)
    message = lab.error_of(lambda: lab.render_file(tmp_path / "a.png"))
    assert "frames:" in message and "frame_0003.ply" in message
    placed, complete = Copies().copied(sources(bpy.context.evaluated_depsgraph_get()))
    assert complete and len(placed[0].frozen.vertices) == 320  # a viewport shows the last one
    assert "frame_0003.ply" in drawn(SequencePanel)
    scene.frame_set(5)
    assert number_of(playing) == 4 and not frame_sync.problem_of(playing)


def test_the_folder_moves_with_the_file(scene, playing, folder, tmp_path) -> None:
    """Oracle: Blender's own rule for relative paths; file and folder are moved together."""
    (tmp_path / "old").mkdir()
    folder.rename(tmp_path / "old" / "frames")
    playing.gscore_sequence.folder = str(tmp_path / "old" / "frames")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "old" / "a.blend"))
    assert playing.gscore_sequence.folder == "//frames"
    (tmp_path / "old").rename(tmp_path / "new")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "new" / "a.blend"))
    bpy.context.scene.frame_set(6)
    assert number_of(bpy.data.objects["frames"]) == 5
    (tmp_path / "new" / "frames").rename(tmp_path / "new" / "elsewhere")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "new" / "a.blend"))
    bpy.context.scene.frame_set(2)
    ob = bpy.data.objects["frames"]
    assert number_of(ob) == 0  # as it was saved
    assert "choose where it is now" in frame_sync.problem_of(ob)
    bpy.context.view_layer.objects.active = ob
    assert "choose where it is now" in drawn(SequencePanel)


def test_edits_make_it_stand_still(scene, playing) -> None:
    """No edit is lost: deleted splats stay deleted, also when drawn, and edits can be discarded."""
    scene.frame_set(3)
    keep = np.arange(320) < 100
    points.keep(playing.data, keep)
    playing.data.update()
    bpy.context.view_layer.update()
    assert playing.gscore_sequence.edited and "(Discard Edits and Play)" in drawn(SequencePanel)
    scene.frame_set(5)
    assert len(playing.data.vertices) == 100 and shown()[0][0] == 100
    bpy.ops.gscore.play_again()
    assert number_of(playing) == 4 and not playing.gscore_sequence.edited
    assert shown()[0][0] == 340


def test_edit_mode_shows_the_mesh_and_nothing_writes_to_it(scene, playing) -> None:
    """Oracle: Blender's edit mesh, at any frame of the timeline."""
    scene.frame_set(2)
    bpy.ops.object.mode_set(mode="EDIT")
    scene.frame_set(5)
    bpy.ops.object.mode_set(mode="OBJECT")
    assert number_of(playing) == 1 and not playing.gscore_sequence.edited
    scene.frame_set(4)
    assert number_of(playing) == 3


def test_undo_in_the_middle(scene, playing) -> None:
    """Oracle: Blender's undo; the object plays on, whichever mesh was restored."""
    bpy.ops.ed.undo_push(message="before")
    scene.frame_set(4)
    playing.location.x = 1
    bpy.ops.ed.undo_push(message="moved")
    bpy.ops.ed.undo()
    ob = bpy.data.objects["frames"]
    bpy.context.scene.frame_set(6)
    assert number_of(ob) == 5 and not ob.gscore_sequence.edited


def test_a_frame_that_is_kept(scene, playing) -> None:
    """The file of the frame, in an object without a sequence."""
    scene.frame_set(4)
    assert bpy.ops.gscore.keep_frame() == {"FINISHED"}
    kept = bpy.context.object
    scene.frame_set(1)
    assert kept.name == "frames 3" and number_of(kept) == 3 and number_of(playing) == 0


def test_a_linked_file_plays_but_keeps_its_mesh(scene, playing, tmp_path) -> None:
    """Oracle: the splats of the pictures; a linked mesh cannot be written, without an error."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "lib.blend"))
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "lib.blend"), link=True) as (_, into):
        into.objects = ["frames"]
    bpy.context.scene.collection.objects.link(into.objects[0])
    bpy.context.scene.frame_set(5)
    assert number_of(into.objects[0]) == 0
    assert shown()[0][0] == 340


def test_closed_file_releases_all_memory(scene, playing) -> None:
    """Oracle: the memory of the session, and Blender's meshes."""
    shown()
    assert LIBRARY.loaded[0] > 0
    bpy.ops.wm.read_homefile(use_empty=True)
    assert LIBRARY.loaded == (0, 0) and not len(bpy.data.meshes)
    until(lambda: not poll_timer.poll())


def test_a_sequence_under_a_capture_needs_no_axis(scene, folder) -> None:
    """Oracle: the parent; a wrong folder leaves the scene as it was."""
    before = len(bpy.data.objects), len(bpy.data.meshes)
    with pytest.raises(RuntimeError, match="has no frames"):
        bpy.ops.gscore.import_sequence(directory=str(folder.parent))
    assert (len(bpy.data.objects), len(bpy.data.meshes)) == before


def test_the_mesh_follows_bit_by_bit_where_there_is_a_window(scene, playing, monkeypatch) -> None:
    """Oracle: the mesh after some polls; the frame change itself writes nothing."""
    monkeypatch.setattr(frame_sync, "_at_once", lambda scene: False)
    scene.frame_set(4)
    assert number_of(playing) == 0
    until(lambda: number_of(playing) == 3)
    assert mesh.file_label(playing).startswith("3 ") and not mesh.was_edited(playing)
    until(lambda: not poll_timer.poll())
    scene.frame_set(6)
    playing.gscore_sequence.beyond = "HIDE"
    scene.frame_set(7)
    until(lambda: len(playing.data.vertices) == 0)
    assert [m for m in bpy.data.meshes if "gs_temporary" in m] == []


def test_mesh_data_is_kept_or_stops_playback(scene, playing, monkeypatch) -> None:
    """Oracle: a user's property on the mesh of a later frame; with an edge, which would be lost,
    the mesh stays, with a message until the edge is removed."""
    monkeypatch.setattr(frame_sync, "_at_once", lambda scene: False)
    playing.data["mine"] = 4
    scene.frame_set(4)
    until(lambda: number_of(playing) == 3)
    assert playing.data["mine"] == 4
    playing.data.edges.add(1)
    scene.frame_set(6)
    until(lambda: "has edges or faces" in frame_sync.problem_of(playing))
    until(lambda: not poll_timer.poll())
    assert number_of(playing) == 3 and len(playing.data.edges) == 1
    assert [m for m in bpy.data.meshes if "gs_temporary" in m] == []
    edited = bmesh.new()
    edited.from_mesh(playing.data)
    edited.edges.ensure_lookup_table()
    edited.edges.remove(edited.edges[0])
    edited.to_mesh(playing.data)
    edited.free()
    scene.frame_set(5)
    until(lambda: number_of(playing) == 4)
    assert not frame_sync.problem_of(playing)


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("number", [0, 1])
def test_edges_stop_it_at_once_too(scene, playing, shared: bool, number: int) -> None:
    """Oracle: the earlier splats and edge, whatever the mesh's other users and the number of new
    splats; no mesh is left over."""
    if shared:
        scene.collection.objects.link(playing.copy())
    playing.data.edges.add(1)
    before, meshes = number_of(playing), len(bpy.data.meshes)
    frame = SimpleNamespace(splats=frame_splats(number), file=None)
    with pytest.raises(ValueError, match="has edges or faces"):
        mesh.fill_mesh(playing, frame)
    assert number_of(playing) == before and len(playing.data.edges) == 1
    assert len(bpy.data.meshes) == meshes


@pytest.fixture
def scrubbed(scene, playing, monkeypatch) -> bpy.types.Object:
    """As in a window just after scrubbing to frame 4, before the mesh has followed."""
    monkeypatch.setattr(frame_sync, "_at_once", lambda scene: False)
    scene.frame_set(4)
    assert number_of(playing) == 0
    return playing


def test_an_export_after_scrubbing_has_the_frame_that_shows(scrubbed, tmp_path) -> None:
    """Oracle: the frame's file, read back from the export."""
    bpy.ops.gscore.export_splats(filepath=str(tmp_path / "out.ply"), world="SOURCE")
    assert read_splats(tmp_path / "out.ply").means.shape == (330, 3)
    np.testing.assert_array_equal(objects.read(scrubbed).means, frame_splats(3).means)


@pytest.mark.parametrize(
    "name",
    ["select_by_opacity", "select_splats", "grade_splats", "add_crop_box", "apply_filters"],
)
def test_an_edit_after_scrubbing_is_one_of_the_frame_that_shows(scene, scrubbed, name) -> None:
    """Oracle: the number of splats of the frame, which stays when the timeline rests."""
    assert getattr(bpy.ops.gscore, name)() == {"FINISHED"}
    if bpy.context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    assert number_of(scrubbed) == 3
    until(lambda: not poll_timer.poll())
    assert number_of(scrubbed) == 3


def test_a_stroke_after_scrubbing_keeps_the_frame_that_shows(scene, scrubbed) -> None:
    """Oracle: the number of splats of the frame, and the colour of the brush, after any wait."""
    stroke, white = [{"name": "", "place": (0.0, 0.0, 0.0)}], (1.0, 1.0, 1.0)
    bpy.ops.gscore.paint_stroke(stroke=stroke, way="PLACES", radius=1e3, hardness=1.0, color=white)
    until(lambda: not poll_timer.poll())
    assert number_of(scrubbed) == 3 and scrubbed.gscore_sequence.edited
    colors = sh0_to_rgb(objects.read(scrubbed).sh0)
    np.testing.assert_allclose(colors, 1.0, atol=1e-6)


def test_a_mesh_on_its_way_never_lands_on_an_edit(scene, scrubbed) -> None:
    """Oracle: the edited splats, after any wait."""
    poll_timer.poll()  # starts to load frame 3
    scrubbed.gscore.opacity_min = 0.5
    assert bpy.ops.gscore.apply_filters() == {"FINISHED"}
    left = len(scrubbed.data.vertices)
    assert left < 330
    bpy.context.view_layer.update()
    until(lambda: not poll_timer.poll())
    assert len(scrubbed.data.vertices) == left and scrubbed.gscore_sequence.edited


def test_an_export_of_a_frame_that_cannot_be_read_says_so(scrubbed, folder, tmp_path) -> None:
    """Oracle: no file, and an error with the name of the frame's."""
    (folder / "frame_0003.ply").write_bytes(b"ply\nnonsense")
    LIBRARY.clear()
    export = bpy.ops.gscore.export_splats
    error = lab.error_of(lambda: export(filepath=str(tmp_path / "out.ply")))
    assert "frame_0003" in error and not (tmp_path / "out.ply").exists()


def test_an_edit_that_blender_has_not_seen_is_kept(scene, scrubbed) -> None:
    """Oracle: the splats edited by a script, exported before the scene was evaluated."""
    points.keep(scrubbed.data, np.arange(300) < 120)
    assert len(objects.read(scrubbed)) == 120


def come(**options: Any) -> tuple[bpy.types.Object, Series, list[str]]:
    """Import in short steps."""
    coming, end = TaskRunner(operators.importing_sequence(bpy.context, **options)), time.monotonic()
    while not coming.step():
        assert time.monotonic() < end + 60 and coming.sentence
        time.sleep(0.001)
    return coming.result


@pytest.mark.parametrize("under", [False, True])
def test_an_import_bit_by_bit(scene, folder, under) -> None:
    """Oracle: the import in one call: splats, transform, name, and the mesh's frame label."""
    root = bpy.data.objects.new("Capture", None)
    scene.collection.objects.link(root)
    options = {"called": "", "start": 3, "parent": root if under else None, "up": "Y"}
    got, found, warnings = come(folder=folder, **options)
    wanted, series = import_sequence(bpy.context, folder, **options)
    assert found == series and not warnings
    assert got.name == got.data.name == "frames" and wanted.name == "frames.001"
    assert got.parent == wanted.parent and got.matrix_basis == wanted.matrix_basis
    assert mesh.file_label(got) == mesh.file_label(wanted) and not mesh.was_edited(got)
    for name in ("folder", "files", "start"):
        assert getattr(got.gscore_sequence, name) == getattr(wanted.gscore_sequence, name)
    np.testing.assert_array_equal(objects.read(got).means, objects.read(wanted).means)
    got.data.vertices[0].co.x += 1
    assert mesh.was_edited(got)


def test_an_import_bit_by_bit_that_fails(scene, folder) -> None:
    """Oracle: the errors of the import in one call, and an empty file."""
    options = {"called": "", "start": 1, "parent": None, "up": "-Y"}
    with pytest.raises(ValueError, match="has no frames"):
        come(folder=folder.parent, **options)
    coming = TaskRunner(operators.importing_sequence(bpy.context, folder, **options))
    assert not coming.step()
    coming.cancel()
    assert coming._task.wait(60)  # a mapped file that is cut ends the process
    (folder / "frame_0000.ply").write_bytes(b"no splats")
    with pytest.raises(GsError, match="frame_0000"):
        come(folder=folder, **options)
    assert not bpy.data.objects and not bpy.data.meshes
