"""Holdout splats. Oracle: the compositing formulas, on pictures of each object alone."""

import bpy
import numpy as np
import pytest

from addon.core import Splats
from addon.render import picture
from addon.render.engine import final_cache
from addon.render.pass_renderer import PassRenderer
from addon.render.shutter_lens import ShutterLens, View
from tests.addon import splat_scenes as lab


def veil(z: float, opacity: float) -> Splats:
    """One large flat splat across the view."""
    return Splats(
        means=np.array([[0, 0, z]], np.float32),
        quats=np.array([[1, 0, 0, 0]], np.float32),
        scales=np.log(np.array([[0.5, 0.5, 0.001]], np.float32)),
        opacities=np.array([np.log(opacity / (1 - opacity))], np.float32),
        sh0=np.full((1, 1, 3), 1.0, np.float32),
        shN=np.full((1, 3, 3), 0.3, np.float32),
    )


def cut(ob: bpy.types.Object, how: str) -> None:
    """Hold an object out, by itself or by its collection."""
    if how == "object":
        ob.is_holdout = True
        return
    group = bpy.data.collections.new("cut")
    bpy.context.scene.collection.children.link(group)
    bpy.context.scene.collection.objects.unlink(ob)
    group.objects.link(ob)
    bpy.context.view_layer.layer_collection.children["cut"].holdout = True


@pytest.mark.parametrize("how", ["object", "collection"])
@pytest.mark.parametrize("transparent", [True, False])
def test_a_veil_cuts_its_share_of_what_is_behind(scene, tmp_path, how, transparent):
    """Oracle: (1 - its alpha) times the picture without it, in straight colours."""
    camera = lab.prepare(scene, light=0.3)
    scene.render.film_transparent = transparent
    lab.add(scene, lab.blob())
    alone = lab.render_exr(tmp_path, "alone")
    front = veil(2.0, 0.8)
    cut(lab.add(scene, front, "front"), how)
    got = lab.render_exr(tmp_path)
    through = 1 - lab.truth(camera, front, (90, 70)).alpha
    np.testing.assert_allclose(got[..., 3], alone[..., 3] * through, atol=2e-3)
    # 1/255 is where the rasterizer begins to draw a splat, and 1e-4 where it ends a pixel.
    np.testing.assert_allclose(got[..., :3], alone[..., :3] * through[..., None], atol=8e-3)
    assert through.min() < 0.25 and alone[..., 3].max() > 0.9


def test_splats_in_front_of_a_holdout_stay(scene, tmp_path):
    """Oracle: the picture of the splats in front of it alone; and an empty one of it alone."""
    lab.prepare(scene)
    scene.render.film_transparent = True
    lab.add(scene, lab.blob(center=(0, 0, 1.5), size=0.3))
    alone = lab.render_exr(tmp_path, "alone")
    back = lab.add(scene, lab.wall(-1.0, (0.9, 0.1, 0.1), half=3.0), "back")
    back.is_holdout = True
    got = lab.render_exr(tmp_path)
    np.testing.assert_allclose(got, alone, atol=2e-3)
    bpy.data.objects.remove(bpy.data.objects["splats"])
    assert np.abs(lab.render_exr(tmp_path, "hole")).max() < 1e-6


@pytest.mark.parametrize("how", ["camera", "indirect"])
def test_camera_invisible_objects_are_not_drawn(scene, tmp_path, how):
    """Oracle: the picture without it."""
    lab.prepare(scene)
    lab.add(scene, lab.blob())
    alone = lab.render_exr(tmp_path, "alone")
    ob = lab.add(scene, lab.wall(1.0, (0.9, 0.1, 0.1)), "unseen")
    assert np.abs(lab.render_exr(tmp_path, "both") - alone).max() > 0.1
    if how == "camera":
        ob.visible_camera = False
    else:
        cut(ob, "collection")
        layer = bpy.context.view_layer.layer_collection.children["cut"]
        layer.holdout, layer.indirect_only = False, True
    np.testing.assert_array_equal(lab.render_exr(tmp_path), alone)


def test_the_viewport_cuts_the_same_hole(scene, tmp_path):
    """Oracle: F12, pixel by pixel, from the model that viewports draw."""
    camera = lab.prepare(scene)
    scene.render.film_transparent = True
    lab.add(scene, lab.blob())
    lab.add(scene, veil(2.0, 0.8), "front").is_holdout = True
    wanted = lab.render_exr(tmp_path)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    shutter_lens = ShutterLens(depsgraph, camera, (90, 70), final_cache, lambda *_: None)
    view = View(model=lab.model_of(depsgraph), camera=shutter_lens.view().camera)
    pass_renderer = PassRenderer(options=picture.Options(), transparent=True, to_scene=np.eye(3))
    got = pass_renderer.render(view, lambda: False)["Combined"][::-1]
    np.testing.assert_allclose(got, wanted, atol=1e-5)
