"""View-dependent colours of soft splats. Oracle: the add-on's engine in the same scene."""

from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from addon import attributes
from addon.core import Splats
from addon.splats import objects, write_chunked
from tests.addon import splat_scenes
from tests.light_changes import encode

PLACES = {
    "plain": Matrix.Identity(4),
    "turned": Matrix.Rotation(0.9, 4, (1, 2, 3)) @ Matrix.Scale(1.2, 4),
    "mirrored": Matrix.Rotation(-0.6, 4, (3, 1, 1)) @ Matrix.Diagonal((-0.9, 0.9, 0.9, 1)),
}
VIEWS = {
    "frontal": Matrix.Translation((0, 0, 4)),
    "side": Matrix.Rotation(1.3, 4, "Y") @ Matrix.Translation((0, 0, 4)),
}


def apart(rest: int) -> Splats:
    """Balls that do not overlap in these views, with strong harmonics."""
    rng = np.random.default_rng(rest)
    middles = np.array([[0, 0, 0], [0, 0.9, 0], [0, -0.9, 0]], np.float32)
    count = len(middles)
    return Splats(
        means=middles,
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        scales=np.log(np.full((count, 3), 0.12, np.float32)),
        opacities=np.full(count, 3, np.float32),
        sh0=rng.uniform(-0.3, 0.3, (count, 1, 3)).astype(np.float32),
        shN=rng.uniform(-0.25, 0.25, (count, rest, 3)).astype(np.float32),
    )


def mean_color(folder: Path, engine: str) -> np.ndarray:
    """[3] mean of the sRGB colours of a picture, weighted by alpha."""
    bpy.context.scene.render.engine = engine
    pixels = splat_scenes.render_exr(folder, engine).astype(np.float64)
    alpha = pixels[..., 3:]
    colors = encode(pixels[..., :3] / np.maximum(alpha, 1e-6))
    return (colors * alpha).sum((0, 1)) / alpha.sum()


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize(
    ("place", "degree"), [("plain", 0), ("plain", 1), ("plain", 2), ("turned", 3), ("mirrored", 3)]
)
def test_cycles_shows_what_the_engine_shows(
    scene: bpy.types.Scene, tmp_path: Path, place: str, degree: int, view: str
) -> None:
    """Oracle: the mean colour of the add-on's engine, within 3/255."""
    camera = splat_scenes.prepare(scene, (48, 40))
    scene.render.film_transparent = True
    ob = splat_scenes.add(scene, apart(attributes.SH_COUNTS[degree]))
    ob.gscore.display = "SOFT"
    ob.matrix_world, camera.matrix_world = PLACES[place], VIEWS[view]
    scene.cycles.samples, scene.cycles.use_denoising = 16, False
    bpy.context.view_layer.update()
    wanted = mean_color(tmp_path, "GSCORE_SPLATS")
    np.testing.assert_allclose(mean_color(tmp_path, "CYCLES"), wanted, atol=3 / 255)


@pytest.mark.parametrize("way", ["refresh", "replace"])
def test_the_degree_follows_the_splats(scene: bpy.types.Scene, tmp_path: Path, way: str) -> None:
    """Oracle: the engine's mean colour, after splats without harmonics were replaced by others."""
    splat_scenes.prepare(scene, (48, 40))
    scene.render.film_transparent = True
    ob = splat_scenes.add(scene, apart(0))
    ob.gscore.display = "SOFT"
    if way == "refresh":
        objects.refresh(ob, apart(15))
    else:
        write_chunked.replace(ob, objects.create(apart(15), "other").data.copy())
        bpy.data.objects.remove(bpy.data.objects["other"])
    scene.cycles.samples, scene.cycles.use_denoising = 16, False
    wanted = mean_color(tmp_path, "GSCORE_SPLATS")
    np.testing.assert_allclose(mean_color(tmp_path, "CYCLES"), wanted, atol=3 / 255)
