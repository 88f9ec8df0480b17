"""The button Show Splats. Oracle: Blender's settings, and the splats' positions by numpy."""

from pathlib import Path

import bpy
import numpy as np
import pytest

from addon.splats import splat_framing
from tests.addon import splat_scenes as lab
from tests.addon.calls import import_capture
from tests.addon.captures import write_capture


def test_one_button_shows_splats(scene: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: engine, colours, photos, selection and visibility afterwards."""
    write_capture(tmp_path / "odd", np.random.default_rng(0), photos=True)
    import_capture(bpy.context.scene, tmp_path / "odd")
    ob = lab.add(scene, lab.blob())
    ob.hide_viewport = True
    scene.gscore.result = ob
    scene.view_settings.view_transform = "AgX"
    assert bpy.ops.gscore.show_splats() == {"FINISHED"}
    assert (scene.render.engine, scene.view_settings.view_transform) == (
        "GSCORE_SPLATS",
        "Standard",
    )
    assert not scene.gscore_photos.shown and not ob.hide_viewport
    assert bpy.context.object == ob and bpy.context.selected_objects == [ob]


def test_after_a_training_it_shows_what_was_trained(scene: bpy.types.Scene) -> None:
    """Oracle: the active object, with other splats active before; without a result, or with a
    deleted one, the existing splats."""
    trained, other = lab.add(scene, lab.blob()), lab.add(scene, lab.blob())
    scene.gscore.result = trained
    bpy.context.view_layer.objects.active = other
    assert bpy.ops.gscore.show_splats() == {"FINISHED"} and bpy.context.object == other
    assert bpy.ops.gscore.show_splats(trained=True) == {"FINISHED"}
    assert bpy.context.object == trained
    bpy.data.objects.remove(trained)
    bpy.context.view_layer.objects.active = None
    assert bpy.ops.gscore.show_splats(trained=True) == {"FINISHED"}
    assert bpy.context.object == other


def test_splats_in_edit_mode_are_shown(scene: bpy.types.Scene) -> None:
    """Oracle: the frame of Object Mode, moved with the splats; Edit Mode stays."""
    ob = lab.add(scene, lab.blob())
    middle, radius = splat_framing.frame_of(ob)
    bpy.context.view_layer.objects.active = ob
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.transform.translate(value=(1, 2, 3))
    assert bpy.ops.gscore.show_splats() == {"FINISHED"}
    assert ob.mode == "EDIT" and scene.render.engine == "GSCORE_SPLATS"
    moved, same = splat_framing.frame_of(ob)
    np.testing.assert_allclose(moved - middle, (1, 2, 3), atol=1e-5)
    np.testing.assert_allclose(same, radius, rtol=1e-5)


@pytest.mark.parametrize("name", ["show_splats", "select_result"])
def test_another_object_leaves_its_mode(scene: bpy.types.Scene, name: str) -> None:
    """Oracle: as after a click on an object in Object Mode, no inactive one is in Edit Mode."""
    scene.gscore.result = lab.add(scene, lab.blob())
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    bpy.ops.object.mode_set(mode="EDIT")
    assert getattr(bpy.ops.gscore, name)() == {"FINISHED"}
    assert bpy.context.object == scene.gscore.result and cube.mode == "OBJECT"


def test_the_frame_holds_most_splats_and_no_sky(scene: bpy.types.Scene) -> None:
    """Oracle: a ball of known middle and radius, moved and scaled, and one splat far away."""
    rng = np.random.default_rng(0)
    splats = lab.blob(1000)
    ball = rng.normal(size=(1000, 3))
    splats.means[:] = ball / np.linalg.norm(ball, axis=1, keepdims=True)
    splats.means[0] = 1e4
    ob = lab.add(scene, splats)
    ob.location, ob.scale = (5, 0, -2), (3, 3, 3)
    bpy.context.view_layer.update()
    middle, radius = splat_framing.frame_of(ob)
    np.testing.assert_allclose(middle, (5, 0, -2), atol=0.4)
    np.testing.assert_allclose(radius, 3, atol=0.4)


def test_the_frame_is_around_what_stands_on_the_ground(scene: bpy.types.Scene) -> None:
    """Oracle: a figure of two metres on a floor that has two thirds of the splats."""
    rng = np.random.default_rng(0)
    splats = lab.blob(900)
    splats.means[:] = rng.uniform((-0.3, -0.3, 0), (0.3, 0.3, 2), (900, 3))
    splats.means[:600] = rng.uniform((-1, -1, -0.01), (1, 1, 0), (600, 3))
    ob = lab.add(scene, splats)
    bpy.context.view_layer.update()
    middle, radius = splat_framing.frame_of(ob)
    assert 0.8 < middle[2] < 1.1 and radius > 1


def test_without_splats_it_is_a_sentence(scene: bpy.types.Scene) -> None:
    """Oracle: the remedy in the message; an object without splats is named."""
    assert "import a splat" in lab.error_of(bpy.ops.gscore.show_splats)
    ob = lab.add(scene, lab.blob(0))
    bpy.context.view_layer.objects.active = ob
    assert "has no splats to show" in lab.error_of(bpy.ops.gscore.show_splats)
