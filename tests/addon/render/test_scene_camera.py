"""Scene camera of shown splats. Oracle: Blender's startup file, projection and undo."""

from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Matrix, Vector

from addon.cameras import scene_camera
from addon.cameras.objects import cameras_of, is_camera
from addon.core import Splats, write_splats
from tests.addon import splat_scenes as lab
from tests.addon.calls import import_capture
from tests.addon.captures import STUDIO


@pytest.fixture
def startup() -> bpy.types.Scene:
    """The scene of File > New > General."""
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    return bpy.context.scene


def ball_of_splats(scene: bpy.types.Scene, size: float) -> bpy.types.Object:
    """Splats in a ball around (50, 0, 0), with a radius of twice `size`."""
    splats = lab.blob(500)
    splats.means[:] /= np.linalg.norm(splats.means, axis=1, keepdims=True)
    splats.means[:] *= 2 * size
    ob = lab.add(scene, splats)
    ob.location = 50, 0, 0
    bpy.context.view_layer.update()
    return ob


def in_picture(scene: bpy.types.Scene, ob: bpy.types.Object) -> np.ndarray:
    """[N, 3] positions of the splats in the scene camera's picture, from 0 to 1, and depths."""
    bpy.context.view_layer.update()
    places = (ob.matrix_world @ vertex.co for vertex in ob.data.vertices)
    return np.array([world_to_camera_view(scene, scene.camera, one) for one in places])


@pytest.mark.parametrize("size", [0.001, 1.0, 1e4])
@pytest.mark.parametrize("frame", [(1920, 1080, 1.0), (600, 1000, 1.0), (800, 600, 1.5)])
def test_a_new_camera_frames_splats_without_photos(
    startup: bpy.types.Scene, size: float, frame: tuple[int, int, float]
) -> None:
    """Oracle: Blender's projection of a ball: all of it in the picture, across half of the shorter
    side or more, within the clipping range; the startup file's camera stays, unused."""
    render, default = startup.render, startup.camera
    render.resolution_x, render.resolution_y, render.pixel_aspect_x = frame
    ob = ball_of_splats(startup, size)
    assert bpy.ops.gscore.show_splats() == {"FINISHED"}
    assert startup.camera not in (None, default) and default.name in startup.objects
    placed = in_picture(startup, ob)
    assert placed[:, :2].min() > 0 and placed[:, :2].max() < 1
    assert np.ptp(placed[:, :2], axis=0).max() > 0.5
    assert placed[:, 2].min() > startup.camera.data.clip_start
    assert placed[:, 2].max() < startup.camera.data.clip_end
    assert (render.resolution_x, render.resolution_y, render.pixel_aspect_x) == frame


def test_a_figure_is_framed_with_its_head(startup: bpy.types.Scene) -> None:
    """Oracle: the projection of a figure, thinner and with fewer splats towards the top."""
    splats = lab.blob(2000)
    rng = np.random.default_rng(0)
    height = 1.7 * rng.uniform(0, 1, 2000) ** 1.3
    across = rng.uniform(-0.25, 0.25, (2000, 2)) * (1.2 - 0.5 * height[:, None])
    splats.means[:] = np.concatenate([across, height[:, None]], axis=1)
    ob = lab.add(startup, splats)
    bpy.context.view_layer.update()
    assert bpy.ops.gscore.show_splats() == {"FINISHED"}
    placed = in_picture(startup, ob)
    assert placed[:, :2].min() > 0 and placed[:, :2].max() < 1


def test_a_photo_of_the_capture_is_the_scene_camera(
    startup: bpy.types.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the photo camera nearest to the view's direction, with its photo's size; the photos
    stay hidden."""
    made = import_capture(startup, STUDIO)
    ob = lab.add(startup, lab.blob())
    ob.parent = made.root
    bpy.context.view_layer.update()
    chosen = made.cameras[11]
    monkeypatch.setattr(
        scene_camera, "direction_of", lambda scene: -chosen.matrix_world.col[2].xyz.normalized()
    )
    startup.gscore_photos.shown = True
    assert bpy.ops.gscore.show_splats() == {"FINISHED"}
    assert startup.camera == chosen
    assert (startup.render.resolution_x, startup.render.resolution_y) == (480, 640)
    assert not any(camera.data.show_background_images for camera in cameras_of(made.root))


@pytest.mark.parametrize("removed", [True, False])
def test_undo_restores_the_scene_camera(startup: bpy.types.Scene, removed: bool) -> None:
    """Oracle: camera and size before Show Splats, with Blender's camera and without one."""
    if removed:
        bpy.data.objects.remove(startup.camera)
    before = startup.camera and startup.camera.name
    made = import_capture(startup, STUDIO)
    lab.add(startup, lab.blob()).parent = made.root
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.gscore.show_splats() == {"FINISHED"}
    assert is_camera(startup.camera)
    bpy.ops.ed.undo_push(message="Show Splats")
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert (scene.camera and scene.camera.name) == before
    assert (scene.render.resolution_x, scene.render.resolution_y) == (1920, 1080)


def _keyed(scene: bpy.types.Scene) -> None:
    scene.camera.keyframe_insert("location", frame=1)


def _tracking(scene: bpy.types.Scene) -> None:
    scene.camera.constraints.new("TRACK_TO").target = scene.objects["Cube"]


def _marked(scene: bpy.types.Scene) -> None:
    scene.timeline_markers.new("cut", frame=1).camera = scene.camera


def _another(scene: bpy.types.Scene) -> None:
    scene.camera = bpy.data.objects.new("mine", bpy.data.cameras.new("mine"))
    scene.collection.objects.link(scene.camera)


CHOICES: dict[str, Callable[[bpy.types.Scene], object]] = {
    "moved": lambda scene: setattr(scene.camera, "location", (7.4, -7, 5)),
    "turned": lambda scene: setattr(scene.camera.rotation_euler, "z", 0.82),
    "parented": lambda scene: setattr(scene.camera, "parent", scene.objects["Cube"]),
    "lens": lambda scene: setattr(scene.camera.data, "lens", 35),
    "panorama": lambda scene: setattr(scene.camera.data, "type", "PANO"),
    "focus": lambda scene: setattr(scene.camera.data.dof, "use_dof", True),
    "keyed": _keyed,
    "tracking": _tracking,
    "marked": _marked,
    "another": _another,
}


@pytest.mark.parametrize("choice", CHOICES)
def test_a_chosen_camera_stays(startup: bpy.types.Scene, choice: str) -> None:
    """Oracle: the same camera and resolution, if a user has changed or replaced Blender's."""
    lab.add(startup, lab.blob())
    CHOICES[choice](startup)
    bpy.context.view_layer.update()
    before = startup.camera, startup.camera.matrix_world.copy()
    assert bpy.ops.gscore.show_splats() == {"FINISHED"}
    assert (startup.camera, startup.camera.matrix_world) == before
    assert (startup.render.resolution_x, startup.render.resolution_y) == (1920, 1080)


def test_imported_splats_of_a_capture_get_its_camera(
    startup: bpy.types.Scene, make_splats: Callable[..., Splats], tmp_path: Path
) -> None:
    """Oracle: one of the capture's cameras, unless the views are not framed; without a capture no
    camera is added."""
    file = str(tmp_path / "splats.ply")
    write_splats(file, make_splats())
    default = startup.camera
    bpy.ops.gscore.import_splats(filepath=file)
    assert startup.camera == default
    assert [ob for ob in startup.objects if ob.type == "CAMERA"] == [default]
    made = import_capture(startup, STUDIO)
    bpy.context.view_layer.objects.active = made.root
    bpy.ops.gscore.import_splats(filepath=file, turn_views=False)
    assert startup.camera == default
    bpy.context.view_layer.objects.active = made.root
    bpy.ops.gscore.import_splats(filepath=file)
    assert startup.camera in made.cameras


def test_a_damaged_photo_camera_is_named(startup: bpy.types.Scene) -> None:
    """Oracle: the camera's name in the warning; the scene camera stays, the splats are shown."""
    made = import_capture(startup, STUDIO)
    lab.add(startup, lab.blob()).parent = made.root
    for ob in made.cameras:
        del ob["gs_K"]
    default = startup.camera
    assert bpy.ops.gscore.show_splats() == {"FINISHED"}
    assert startup.camera == default and startup.render.engine == "GSCORE_SPLATS"


def test_the_new_camera_looks_as_the_view_does(
    startup: bpy.types.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the direction of a view from above."""
    down = Vector((0, 0, -1))
    monkeypatch.setattr(scene_camera, "direction_of", lambda scene: down)
    ball_of_splats(startup, 1.0)
    bpy.ops.gscore.show_splats()
    bpy.context.view_layer.update()
    matrix: Matrix = startup.camera.matrix_world
    assert (-matrix.col[2].xyz - down).length < 1e-5
    np.testing.assert_allclose(matrix.translation[:2], (50, 0), atol=0.3)
