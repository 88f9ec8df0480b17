"""Import of levels of detail. Oracle: the files read with gscore, and the scene before."""

from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from addon.core import Splats, read_lod, write_splats
from addon.splats import objects, splat_files
from gscore.frontend import LodFacts, build_lod
from gscore.lod import build, groups

COUNT = 2000


@pytest.fixture
def lod(tmp_path: Path, make_splats: Callable[..., Splats], monkeypatch) -> Path:
    """Three levels: 2000 splats in 16 chunks, 500 and 125; merged in file order, because Blender
    has no scipy to find neighbours."""
    monkeypatch.setattr(groups, "MOST_IN_A_CHUNK", 150)
    monkeypatch.setattr(build, "groups_of", lambda means, *_: np.arange(len(means)) // 4)
    write_splats(tmp_path / "city.ply", make_splats(COUNT))
    build_lod(tmp_path / "city.ply", tmp_path / "city.lod", LodFacts(antialias=True))
    return tmp_path / "city.lod"


def rows(means: np.ndarray) -> np.ndarray:
    """Positions in sorted order."""
    return means[np.lexsort(means.T)]


def test_the_finest_that_is_not_too_many(scene, lod: Path, monkeypatch) -> None:
    """Oracle: the level; its splats are those of the file, and marked as antialiased."""
    assert bpy.ops.gscore.import_splats(filepath=str(lod)) == {"FINISHED"}
    assert len(bpy.context.object.data.vertices) == COUNT
    monkeypatch.setattr(splat_files, "MOST_AT_ONCE", 600)
    bpy.ops.gscore.import_splats(filepath=str(lod))
    ob = bpy.context.object
    np.testing.assert_allclose(objects.read(ob).means, read_lod(lod, 1).splats.means, atol=3e-6)
    assert ob.name.startswith("city") and ob[objects.ANTIALIAS]
    bpy.ops.gscore.import_splats(filepath=str(lod), level=2)
    assert len(bpy.context.object.data.vertices) == 125


def test_the_crop_of_the_finest(scene, lod: Path) -> None:
    """Oracle: the splats of the whole file inside the rotated box; they have the transform of the
    coarse ones, which were moved after their import."""
    bpy.ops.gscore.import_splats(filepath=str(lod), level=2)
    coarse = bpy.context.object
    coarse.location, coarse.rotation_euler = (1, 2, 3), (0.3, 0.2, 0.1)
    bpy.context.view_layer.update()
    bpy.ops.gscore.add_crop_box()
    box = coarse.gscore.crop_object
    box.rotation_euler, box.scale = (0, 0.4, 0.5), (0.5, 0.4, 0.6)
    bpy.context.view_layer.update()
    bpy.ops.gscore.import_splats(filepath=str(lod), in_crop=True)
    fine = bpy.context.object
    bpy.context.view_layer.update()
    np.testing.assert_allclose(fine.matrix_world, coarse.matrix_world, atol=1e-6)
    means = read_lod(lod, 0).splats.means.astype(np.float64)
    to_box = np.array(box.matrix_world.inverted() @ coarse.matrix_world)
    inside = (np.abs(means @ to_box[:3, :3].T + to_box[:3, 3]) <= 1).all(axis=1)
    found = objects.read(fine).means
    assert 0 < inside.sum() < COUNT / 2 and abs(len(found) - inside.sum()) <= 1
    if len(found) == inside.sum():
        np.testing.assert_allclose(rows(found), rows(means[inside]), atol=3e-6)


def test_failed_import_changes_nothing(scene, lod: Path) -> None:
    """Oracle: an error with the reason, and the scene as before."""
    with pytest.raises(RuntimeError, match="has 3 levels"):
        bpy.ops.gscore.import_splats(filepath=str(lod), level=7)
    with pytest.raises(RuntimeError, match="Select the splat object"):
        bpy.ops.gscore.import_splats(filepath=str(lod), in_crop=True)
    with pytest.raises(RuntimeError, match="has no levels of detail"):
        bpy.ops.gscore.import_splats(filepath=str(lod.with_suffix(".ply")), level=1)
    assert not scene.objects
    bpy.ops.gscore.import_splats(filepath=str(lod), level=2)
    with pytest.raises(RuntimeError, match="has no crop object"):
        bpy.ops.gscore.import_splats(filepath=str(lod), in_crop=True)
    bpy.ops.gscore.add_crop_box()
    box = bpy.context.object
    box.matrix_world = Matrix.Translation((1e4, 0, 0))
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="No splat of"):
        bpy.ops.gscore.import_splats(filepath=str(lod), in_crop=True)
    assert len(scene.objects) == 2
    lod.write_bytes(lod.read_bytes()[:-5])
    with pytest.raises(RuntimeError, match="truncated or damaged"):
        bpy.ops.gscore.import_splats(filepath=str(lod))
