"""Incremental export and import of camera paths. Oracle: the same in one call, and the data
before."""

import gc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from addon.cameras import camera_path, camera_path_import
from addon.compat import curves_of
from addon.process.background_task import Cancelled
from addon.process.incremental_tasks import TaskRunner, ThreadCall
from tests.addon.calls import export_path, import_capture, import_path
from tests.addon.cameras.test_camera_path import camera  # noqa: F401 - a fixture
from tests.addon.cameras.test_importing import until
from tests.addon.captures import STUDIO
from tools.measure.windowless import windowless

KINDS = ("objects", "cameras", "collections", "actions")


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """One frame or curve per step."""
    for module in (camera_path, camera_path_import):
        monkeypatch.setattr(module, "BUDGET", 0.0)


def going(name: str, file: Path, **settings: Any) -> TaskRunner:
    """The operator in a window, nothing done."""
    given = {"filepath": str(file), "world": "BLENDER", **settings}
    return TaskRunner(windowless(name, **given).steps(bpy.context))


def exporting(file: Path, **settings: Any) -> TaskRunner:
    """The export operator."""
    return going("export_camera_path", file, **settings)


def half(work: TaskRunner) -> Callable[[], bool]:
    """Whether three of six frames are read."""
    return lambda: work.sentence == "Reading frames: 3 of 6"


def counts() -> dict[str, int]:
    """Number of datablocks."""
    return {kind: len(getattr(bpy.data, kind)) for kind in KINDS}


@pytest.mark.parametrize("kind", ["CAMERAS", "TRANSFORMS", "NERFSTUDIO"])
@pytest.mark.parametrize("world", ["BLENDER", "CAPTURE"])
def test_export_as_at_once(scene, camera, tmp_path: Path, kind: str, world: str) -> None:  # noqa: F811
    """Equal to the byte, while the user changes the frame and renames the camera."""
    import_capture(scene, STUDIO, photos=False, points=False)
    scene.camera = camera
    if kind == "NERFSTUDIO":
        camera.data.animation_data_clear()
        camera.data.shift_x = 0
    bpy.ops.gscore.export_camera_path(filepath=str(tmp_path / "a"), world=world, kind=kind)
    work, reported = exporting(tmp_path / "b", world=world, kind=kind), []
    scene.frame_set(5)

    def goes_on() -> bool:
        reported.append(work.sentence)
        moved = "Reading frames: 3 of 6" in reported[:-1]
        assert (scene.frame_current, scene.frame_subframe) == ((6, 0.25) if moved else (5, 0.0))
        if reported.count("Reading frames: 3 of 6") == 1 and not moved:
            scene.frame_set(6, subframe=0.25)
            camera.name = "other"
        return False

    assert until(work, goes_on)
    assert [f"Reading frames: {done} of 6" for done in range(1, 6)] == reported[1:6]
    assert (scene.frame_current, scene.frame_subframe) == (6, 0.25)
    assert "6 frames of moving" in work.result
    assert (tmp_path / "b").read_bytes() == (tmp_path / "a").read_bytes()


@pytest.mark.parametrize("late", [False, True])
def test_export_given_up(scene, camera, tmp_path: Path, late: bool) -> None:  # noqa: F811
    """Oracle: no file, and the user's frame; while frames are read, and while they are written."""
    scene.frame_set(4)
    if not late:
        work = exporting(tmp_path / "a")
        before = gc.get_threshold()
        assert not until(work, half(work)) and gc.get_threshold()[2] > before[2]
        work.cancel()
        assert gc.get_threshold() == before
    else:
        file = str(tmp_path / "a")
        steps = windowless("export_camera_path", filepath=file, world="BLENDER").steps(bpy.context)
        asked = next(one for one in steps if isinstance(one, ThreadCall))

        def given_up() -> None:
            raise Cancelled

        with pytest.raises(Cancelled):
            asked.function(given_up)
        steps.close()
    assert not list(tmp_path.iterdir()) and scene.frame_current == 4


def _camera(scene: bpy.types.Scene) -> None:
    bpy.data.objects.remove(bpy.data.objects["moving"])


def _data(scene: bpy.types.Scene) -> None:
    bpy.data.cameras.remove(bpy.data.cameras["moving"])


def _scene(scene: bpy.types.Scene) -> None:
    bpy.data.scenes.remove(scene)


def _root(scene: bpy.types.Scene) -> None:
    bpy.data.objects.remove(bpy.data.objects["studio"])


def _size(scene: bpy.types.Scene) -> None:
    scene.render.resolution_percentage = 50


def _type(scene: bpy.types.Scene) -> None:
    bpy.data.cameras["moving"].type = "ORTHO"


@pytest.mark.parametrize(
    ("act", "says"),
    [
        (_camera, "Cameras were removed"),
        (_data, "Cameras were removed"),
        (_scene, "The scene or the capture was removed"),
        (_root, "The scene or the capture was removed"),
        (_size, "The resolution was changed"),
        (_type, "moving is not perspective"),
    ],
)
def test_changes_during_a_path_export(
    scene,
    camera,  # noqa: F811
    tmp_path: Path,
    act: Callable[[bpy.types.Scene], None],
    says: str,
) -> None:
    """Oracle: an error, and no file; an existing scene is at the user's frame."""
    import_capture(scene, STUDIO, photos=False, points=False)
    scene.camera = camera
    bpy.data.scenes.new("other")
    scene.frame_set(4)
    work = exporting(tmp_path / "a", world="CAPTURE")
    assert not until(work, half(work))
    act(scene)
    with pytest.raises(ValueError, match=says):
        until(work, lambda: False)
    assert not list(tmp_path.iterdir())
    assert act is _scene or scene.frame_current == 4


def test_export_of_a_scene_that_is_left(scene, camera, tmp_path: Path) -> None:  # noqa: F811
    """Oracle: the export in one call, while the window shows another scene; a scene that no window
    has shown exports its animated lens too."""
    export_path(tmp_path / "a", camera, scene)
    work = exporting(tmp_path / "b")
    assert not until(work, half(work))
    bpy.context.window.scene = other = bpy.data.scenes.new("other")
    assert until(work, lambda: False)
    other.collection.objects.link(camera)
    bpy.data.scenes.remove(scene)
    third = bpy.data.scenes.new("third")
    third.collection.objects.link(camera)
    third.frame_start, third.frame_end = 3, 8
    third.render.resolution_x, third.render.resolution_y = 320, 180
    export_path(tmp_path / "c", camera, third)
    wanted = (tmp_path / "a").read_bytes()
    assert (tmp_path / "b").read_bytes() == wanted
    assert (tmp_path / "c").read_bytes() == wanted


def keys(ob: bpy.types.Object) -> dict[tuple[str, int], list[tuple]]:
    """All keyframes of a camera."""
    return {
        (curve.data_path, curve.array_index): [
            (
                *key.co,
                *key.handle_left,
                *key.handle_right,
                key.handle_left_type,
                key.handle_right_type,
                key.interpolation,
                key.easing,
                key.type,
                key.amplitude,
                key.back,
                key.period,
            )
            for key in curve.keyframe_points
        ]
        for block in (ob, ob.data)
        for curve in curves_of(block)
    }


@pytest.fixture
def file(scene, camera, tmp_path: Path) -> Path:  # noqa: F811
    """A path of frames 3, 5 and 7; no camera."""
    scene.frame_step = 2
    export_path(tmp_path / "walk.json", camera, scene, kind="TRANSFORMS")
    bpy.ops.wm.read_homefile(use_empty=True)
    return tmp_path / "walk.json"


def test_keyframes_as_blender_inserts_them(file: Path) -> None:
    """Oracle: `keyframe_insert` at each frame."""
    scene = bpy.context.scene
    ob = import_path(file, scene).camera
    other = ob.copy()
    other.data = ob.data.copy()
    scene.collection.objects.link(other)
    for block in (other, other.data):
        block.animation_data_clear()
    for frame in (3, 5, 7):
        scene.frame_set(frame)
        other.location, other.rotation_quaternion = ob.location, ob.rotation_quaternion
        other.data.lens, other.data.shift_x = ob.data.lens, ob.data.shift_x
        for name in ("location", "rotation_quaternion"):
            other.keyframe_insert(name, frame=frame)
        for name in ("lens", "shift_x"):
            other.data.keyframe_insert(name, frame=frame)
    ours, theirs = keys(ob), keys(other)
    assert ours.keys() == theirs.keys() and len(ours) == 9
    for name, wanted in theirs.items():
        assert [key[6:] for key in ours[name]] == [key[6:] for key in wanted]
        np.testing.assert_allclose(
            [key[:6] for key in ours[name]], [key[:6] for key in wanted], rtol=1e-6, atol=1e-6
        )


def importing(file: Path, **settings: Any) -> TaskRunner:
    """The import operator."""
    return going("import_camera_path", file, **settings)


def at_curve(work: TaskRunner, number: int) -> Callable[[], bool]:
    """Whether a number of curves is made."""
    return lambda: work.sentence == f"Importing keyframes: curve {number} of 9"


def state() -> dict[str, Any]:
    """Data made by an import."""
    scene = bpy.context.scene
    ob = scene.camera
    return {
        "keys": keys(ob),
        "stands": [tuple(row) for row in ob.matrix_world],
        "lens": ob.data.lens,
        "name": ob.name,
        "in": [one.name for one in ob.users_collection],
        "scene": (scene.frame_start, scene.frame_end, scene.frame_step, scene.render.fps),
        "active": bpy.context.object == ob and ob.select_get(),
        "marks": [key for key in ob.keys() if key.startswith("gs_")],  # noqa: SIM118 - of Blender
        **counts(),
    }


def test_import_as_at_once(file: Path) -> None:
    """Equal to the bit; the scene has nothing of it meanwhile."""
    bpy.ops.gscore.import_camera_path(filepath=str(file), world="BLENDER")
    bpy.context.view_layer.update()
    at_once = state()
    bpy.ops.wm.read_homefile(use_empty=True)
    work, scene = importing(file), bpy.context.scene
    assert not until(work, at_curve(work, 8))
    assert not scene.objects and scene.camera is None and len(bpy.data.cameras) == 1
    assert until(work, lambda: False)
    assert work.result == "walk: 3 cameras, frames 3 to 7"
    bpy.context.view_layer.update()
    assert state() == at_once and at_once["collections"] == 0 and not at_once["marks"]


@pytest.mark.parametrize("number", [0, 1, 8])
def test_import_given_up(file: Path, number: int) -> None:
    """Oracle: the counts of all data before, while it is read and while curves are made."""
    before, work, searched = counts(), importing(file), gc.get_threshold()
    assert not until(work, at_curve(work, number) if number else lambda: True)
    assert (counts() == before) == (number == 0)
    assert (gc.get_threshold() == searched) == (number == 0)
    work.cancel()
    assert counts() == before and gc.get_threshold() == searched


@pytest.mark.parametrize("what", ["scene", "capture"])
def test_import_into_what_is_gone(file: Path, what: str) -> None:
    """Oracle: an error; nothing is left."""
    scene = bpy.context.scene
    import_capture(scene, STUDIO, photos=False, points=False)
    bpy.data.scenes.new("other")
    work = importing(file, world="CAPTURE")
    assert not until(work, at_curve(work, 3))
    (_scene if what == "scene" else _root)(scene)
    for ob in list(bpy.data.objects):
        if "gs_temporary" not in ob:
            bpy.data.objects.remove(ob)
    with pytest.raises(ValueError, match=f"{what} of this import was removed"):
        until(work, lambda: False)
    assert not bpy.data.objects and not bpy.data.actions


def test_import_below_a_capture_meanwhile_renamed(file: Path) -> None:
    """Oracle: the camera is its child, in its collection, with the clip end of its cameras."""
    made = import_capture(bpy.context.scene, STUDIO, photos=False, points=False)
    work = importing(file, world="CAPTURE")
    assert not until(work, at_curve(work, 3))
    made.root.name = "other"
    bpy.context.window.scene = bpy.data.scenes.new("elsewhere")
    assert until(work, lambda: False)
    ob = made.scene.camera
    assert ob.parent == made.root and set(ob.users_collection) == {made.collection}
    assert ob.data.clip_end == made.cameras[0].data.clip_end
    assert made.scene.view_layers[0].objects.active == ob


def test_undo_takes_it(file: Path) -> None:
    """Oracle: undone data are made again; the finished import is one undo step."""
    bpy.ops.ed.undo_push(message="start")
    bpy.context.scene.frame_end = 77
    bpy.ops.ed.undo_push(message="a frame")
    work = importing(file)
    assert not until(work, at_curve(work, 3))
    bpy.ops.ed.undo_push(message="meanwhile")
    bpy.ops.ed.undo()
    bpy.ops.ed.undo()
    assert not bpy.data.objects and not bpy.data.actions and bpy.context.scene.frame_end != 77
    assert until(work, lambda: False)
    assert bpy.context.scene.camera.name == "walk" and len(bpy.data.actions) in (1, 2)
    bpy.ops.ed.undo_push(message="imported")
    bpy.ops.ed.undo()
    assert not bpy.data.objects and bpy.context.scene.camera is None


def test_a_file_that_is_saved_meanwhile(file: Path, tmp_path: Path) -> None:
    """Oracle: the file that was opened again."""
    work = importing(file)
    assert not until(work, at_curve(work, 3))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    work.cancel()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    assert counts() == dict.fromkeys(KINDS, 0)
