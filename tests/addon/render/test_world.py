"""The world of a view layer. Oracle: Cycles' picture of the same layer."""

import bpy
import numpy as np
import pytest

from addon import compat
from tests.addon import splat_scenes as lab


def world(light: float) -> bpy.types.World:
    """A grey world."""
    made = bpy.data.worlds.new("other")
    made.color = (light,) * 3
    tree = compat.world_nodes(made)
    if tree is not None:
        tree.nodes["Background"].inputs[0].default_value = (light, light, light, 1)
    return made


@pytest.mark.parametrize("what", ["sky", "override", "both"])
def test_world_by_view_layer(scene, tmp_path, what):
    """The corner of the picture, where there are no splats."""
    lab.prepare(scene, (20, 16), light=0.3)
    lab.add(scene, lab.blob(20, size=0.1))
    layer = scene.view_layers[0]
    if what != "sky":
        layer.world_override = world(0.7)
    layer.use_sky = what == "override"
    got = lab.render_exr(tmp_path, "ours")[0, 0]
    scene.render.engine, scene.cycles.samples = "CYCLES", 1
    scene.cycles.use_denoising = False
    wanted = lab.render_exr(tmp_path, "cycles")[0, 0]
    np.testing.assert_allclose(got, wanted, atol=1e-4)
    assert wanted[0] == pytest.approx(0.7 if what == "override" else 0, abs=0.01)
