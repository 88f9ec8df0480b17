"""Cycles ends rays among soft splats: a warning, and a button that fixes it."""

from pathlib import Path

import bpy
import numpy as np
import pytest

from addon.compat import splat_cloud_type
from addon.render.operators import ENOUGH, ends_early
from tests.addon import splat_scenes as lab


def picture(path: Path) -> np.ndarray:
    """A render of the scene, [H, W, 4]."""
    bpy.context.scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path), check_existing=False)
    width, height = image.size
    return np.array(image.pixels[:]).reshape(height, width, 4)


@pytest.mark.parametrize(
    ("engine", "display", "hidden", "reported"),
    [
        ("CYCLES", "SOFT", False, True),
        ("CYCLES", "SPLATS", False, not splat_cloud_type()),
        ("CYCLES", "POINTS", False, False),
        ("CYCLES", "SOFT", True, False),
        ("GSCORE_SPLATS", "SOFT", False, False),
    ],
)
def test_when_the_warning_is_shown(
    scene: bpy.types.Scene, engine: str, display: str, hidden: bool, reported: bool
) -> None:
    """Oracle: the displays that render as soft splats; the button removes the warning, in one
    press."""
    ob = lab.add(scene, lab.blob())
    ob.gscore.display, ob.hide_render = display, hidden
    scene.render.engine = engine
    scene.cycles.transparent_max_bounces = 8
    assert ends_early(scene) is reported
    assert bpy.ops.gscore.see_through_splats.poll() is reported
    if reported:
        assert bpy.ops.gscore.see_through_splats() == {"FINISHED"}
        assert scene.cycles.transparent_max_bounces == ENOUGH
        assert not ends_early(scene)


def test_splats_behind_each_other_let_light_through(scene: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: forty faint white splats in a row in front of a camera get brighter by the button."""
    splats = lab.blob(40)
    splats.means[:] = np.linspace(-1, 1, 40)[:, None] * (0, 1, 0)
    splats.scales[:], splats.opacities[:] = np.log(0.5), -3.5
    splats.sh0[:], splats.shN[:] = 1.7, 0.0
    ob = lab.add(scene, splats)
    ob.gscore.display = "SOFT"
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    camera.location, camera.rotation_euler = (0, -6, 0), (np.pi / 2, 0, 0)
    scene.camera, scene.render.engine = camera, "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = 16, 16
    scene.world = None
    scene.cycles.samples, scene.cycles.transparent_max_bounces = 4, 8
    dark = picture(tmp_path / "dark.png")[8, 8, 0]
    assert bpy.ops.gscore.see_through_splats() == {"FINISHED"}
    assert picture(tmp_path / "bright.png")[8, 8, 0] > 1.3 * dark > 0
