"""The filters as a mask. Oracle: conditions by hand."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Euler

from addon.core import Splats
from addon.splats import objects
from addon.splats.filters import BOX, SPHERE, Filters, mask, visible_mask

Make = Callable[..., Splats]
ROOT = Path(__file__).parents[3]
N = 2000


@pytest.fixture
def rows() -> dict[str, np.ndarray]:
    """Positions, scales and opacities as float32."""
    rng = np.random.default_rng(4)
    return {
        "means": rng.uniform(-2, 2, (N, 3)).astype(np.float32),
        "scales": np.exp(rng.uniform(-7, -1, (N, 3))).astype(np.float32),
        "opacities": rng.uniform(0, 1, N).astype(np.float32),
    }


def test_default_filters_show_all(rows: dict[str, np.ndarray]) -> None:
    """Oracle: every splat."""
    assert mask(**rows, filters=Filters()).all()


def test_limits(rows: dict[str, np.ndarray]) -> None:
    """Oracle: numpy comparisons, one by one."""
    got = mask(**rows, filters=Filters(opacity_min=0.3, size_min=0.01, size_max=0.1))
    wanted = [
        o >= np.float32(0.3) and np.float32(0.01) <= max(s) <= np.float32(0.1)
        for o, s in zip(rows["opacities"], rows["scales"], strict=True)
    ]
    assert 100 < got.sum() < N - 100
    np.testing.assert_array_equal(got, wanted)


def test_limits_are_included() -> None:
    """Oracle: values at the limits are shown."""
    one = {
        "means": np.zeros((1, 3), np.float32),
        "scales": np.full((1, 3), 0.1, np.float32),
        "opacities": np.full(1, 0.7, np.float32),
    }
    assert mask(**one, filters=Filters(opacity_min=0.7, size_min=0.1, size_max=0.1)).all()


@pytest.mark.parametrize("invert", [False, True])
@pytest.mark.parametrize("shape", [BOX, SPHERE])
def test_crop(rows: dict[str, np.ndarray], shape: str, invert: bool) -> None:
    """Oracle: |x|, |y|, |z| <= 1, or the length, after halving."""
    crop = np.diag([0.5, 1.0, 2.0, 1.0])
    got = mask(**rows, filters=Filters(crop=crop, crop_shape=shape, crop_invert=invert))
    local = rows["means"] * [0.5, 1, 2]
    inside = (np.abs(local) <= 1).all(1) if shape == BOX else np.linalg.norm(local, axis=1) <= 1
    assert 50 < inside.sum() < N - 50
    np.testing.assert_array_equal(got, inside != invert)


def test_crop_object_in_its_own_frame(scene: bpy.types.Scene, make_splats: Make) -> None:
    """Oracle: mathutils transforms each vertex to the space of a rotated, scaled, off-centre
    mesh."""
    ob = objects.create(make_splats(400), "Splats")
    ob.location, ob.scale = (1, 2, 3), (2, 2, 2)
    mesh = bpy.data.meshes.new("Crop")
    mesh.from_pydata([(-1, 0, 0), (3, 2, 1), (0, 1, 0.5)], [], [(0, 1, 2)])
    crop = bpy.data.objects.new("Crop", mesh)
    crop.location, crop.rotation_euler = (1, 1, 2), Euler((0.3, 0.5, 0.7))
    scene.collection.objects.link(crop)
    ob.gscore.crop_object = crop
    bpy.context.view_layer.update()
    inverse = crop.matrix_world.inverted()
    wanted = []
    for vertex in ob.data.vertices:
        x, y, z = inverse @ (ob.matrix_world @ vertex.co)
        wanted.append(-1 <= x <= 3 and 0 <= y <= 2 and 0 <= z <= 1)
    got = visible_mask(ob)
    assert 5 < got.sum() < 395
    np.testing.assert_array_equal(got, wanted)


def test_empty_counts_one_unit(scene: bpy.types.Scene, make_splats: Make) -> None:
    """Oracle: |x|, |y|, |z| <= scale of the empty."""
    ob = objects.create(make_splats(400), "Splats")
    crop = bpy.data.objects.new("Crop", None)
    crop.scale = (0.5, 1, 2)
    scene.collection.objects.link(crop)
    ob.gscore.crop_object = crop
    bpy.context.view_layer.update()
    wanted = (np.abs(make_splats(400).means) <= [0.5, 1, 2]).all(axis=1)
    np.testing.assert_array_equal(visible_mask(ob), wanted)
    ob.gscore.crop_invert = True
    np.testing.assert_array_equal(visible_mask(ob), ~wanted)


def test_filtered_reading(scene: bpy.types.Scene, make_splats: Make) -> None:
    """Oracle: the rows chosen by hand."""
    ob = objects.create(make_splats(400), "Splats")
    ob.gscore.opacity_min = 0.5
    got = objects.read(ob).subset(visible_mask(ob))
    keep = make_splats(400).opacities >= 0
    assert 0 < keep.sum() < 400
    np.testing.assert_array_equal(got.means, make_splats(400).means[keep])


def test_needs_no_blender() -> None:
    """Oracle: a fresh interpreter in which bpy cannot be imported."""
    code = "import sys; sys.modules['bpy'] = None; import addon.splats.filters; print('fine')"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True
    )
    assert done.stdout.strip() == "fine"
