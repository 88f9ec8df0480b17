"""View-dependent colours of soft splats. Oracle: the engine, which uses other code."""

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from addon.compat import splat_cloud_type
from addon.nodes import harmonics
from addon.nodes.display import modifier_of
from tests.addon import splat_scenes as lab
from tests.light_changes import encode

SIZE = 200
LIMIT = 3 / 255
LIMITS = {"SOFT": LIMIT, "NATIVE": 25 / 255}
"""Largest errors of single colours by display; Blender's own splats have coarser ones."""
OPAQUE = 0.99
"""Opacity at which the engine ends; Cycles does not."""


def centres(scene: bpy.types.Scene, ob: bpy.types.Object, folder: Path, engine: str) -> np.ndarray:
    """sRGB values at the projected centres of the balls, [9, 3]."""
    scene.render.engine = engine
    picture = lab.render_exr(folder, engine)[..., :3]
    found = []
    for vertex in ob.data.vertices:
        u, v, _ = world_to_camera_view(scene, scene.camera, ob.matrix_world @ vertex.co)
        found.append(picture[int((1 - v) * SIZE), int(u * SIZE)])
    return np.clip(encode(np.array(found)), 0, 1)


@pytest.fixture
def ready(scene: bpy.types.Scene) -> bpy.types.Scene:
    """Prepare the scene: black, nearly without noise, a camera off the axis."""
    camera = lab.prepare(scene, (SIZE, SIZE))
    camera.location = (1.5, -2, 5)
    camera.rotation_euler = Vector((-1.5, 2, -5)).to_track_quat("-Z", "Y").to_euler()
    camera.data.lens = 40
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.filter_width = 32, False, 0.01
    return scene


DISPLAYS = ["SOFT", "NATIVE"] if splat_cloud_type() else ["SOFT"]


@pytest.mark.parametrize("rest", [0, 3, 8, 15])
@pytest.mark.parametrize("placed", ["as made", "turned", "mirrored"])
@pytest.mark.parametrize("display", DISPLAYS)
def test_cycles_shows_the_color_from_here(
    ready: bpy.types.Scene, tmp_path: Path, rest: int, placed: str, display: str
) -> None:
    """Oracle: the engine's picture of the same object at the middle of each ball."""
    ob = lab.add(ready, lab.beads(rest))
    if placed != "as made":
        ob.location, ob.rotation_euler, ob.scale = (0.2, -0.3, 0.1), (0.3, 0.1, 2.0), (0.9,) * 3
    if placed == "mirrored":
        ob.scale = (-0.9, 0.9, 0.9)
    ob.gscore.display = display
    bpy.context.view_layer.update()
    want = centres(ready, ob, tmp_path, "GSCORE_SPLATS")
    got = centres(ready, ob, tmp_path, "CYCLES")
    assert np.ptp(want) > 0.3
    np.testing.assert_allclose(OPAQUE * got, want, atol=LIMITS[display])
    assert np.abs(OPAQUE * got - want).mean() < LIMIT


def test_colors_follow_the_camera(ready: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: the engine again, after only the camera has moved; colours have changed."""
    ob = lab.add(ready, lab.beads(15))
    ob.gscore.display = "SOFT"
    before = centres(ready, ob, tmp_path, "CYCLES")
    ready.camera.location = (-2.5, 1, 4.5)
    ready.camera.rotation_euler = Vector((2.5, -1, -4.5)).to_track_quat("-Z", "Y").to_euler()
    bpy.context.view_layer.update()
    want = centres(ready, ob, tmp_path, "GSCORE_SPLATS")
    got = centres(ready, ob, tmp_path, "CYCLES")
    np.testing.assert_allclose(OPAQUE * got, want, atol=LIMIT)
    assert np.abs(got - before).max() > 0.1


def test_the_live_display_renders_them_too(ready: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: the picture of the display Native Splats, before 5.3 that of Soft Splats."""
    ob = lab.add(ready, lab.beads(8))
    ob.gscore.display = DISPLAYS[-1]
    want = centres(ready, ob, tmp_path, "CYCLES")
    ob.gscore.display = "SPLATS"
    np.testing.assert_allclose(centres(ready, ob, tmp_path, "CYCLES"), want, atol=1e-4)


def test_without_a_camera_the_mean_color_is_shown(ready: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: splats without further coefficients, from nodes without a camera."""
    splats = lab.beads(15)
    ob = lab.add(ready, splats)
    ob.gscore.display = "SOFT"
    for tree in {modifier_of(ob).node_group, *bpy.data.node_groups}:
        for node in tree.nodes:
            if node.bl_idname == "GeometryNodeInputActiveCamera":
                for link in list(node.outputs[0].links):
                    tree.links.remove(link)
    bpy.context.view_layer.update()
    got = centres(ready, ob, tmp_path, "CYCLES")
    bpy.data.objects.remove(ob)
    plain = lab.add(ready, replace(splats, shN=splats.shN[:, :0]))
    plain.gscore.display = "SOFT"
    np.testing.assert_allclose(got, centres(ready, plain, tmp_path, "CYCLES"), atol=1e-4)


def test_a_factor_that_is_zero_somewhere_would_be_seen() -> None:
    """Oracle: no basis function is zero at the direction from which factors are derived."""
    for k in range(15):
        assert all(abs(f) > 0.05 for f in harmonics._scaled(k).values())
