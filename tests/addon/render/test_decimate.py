"""Decimation. Oracle: the number of splats, and newly rendered pictures."""

import bpy
import numpy as np
import pytest

from addon.core import importance_of, psnr, render
from addon.render import decimate
from addon.splats import objects
from tests.addon import splat_scenes as lab


def test_the_error_is_stated(scene: bpy.types.Scene) -> None:
    """Oracle: PSNR of pictures before and after, rendered here; the most important splats stay."""
    before = lab.blob(600)
    ob = lab.add(scene, before)
    ob.location, ob.scale = (3, 1, 0), (2, 2, 2)
    bpy.context.view_layer.objects.active = ob
    bpy.context.view_layer.update()
    views = decimate.views_of(ob)
    assert len(views) == 4
    for K, viewmat, width, height in views:
        seen = render(before, K, viewmat, width, height).alpha.squeeze()
        rows, columns = np.nonzero(seen > 0.2)
        assert len(rows) > 1000  # the cameras look at them, in the middle
        assert abs(rows.mean() - height / 2) < 25 and abs(columns.mean() - width / 2) < 25
    assert bpy.ops.gscore.decimate_splats(count=200) == {"FINISHED"}
    after = objects.read(ob)
    kept = np.sort(np.argsort(-importance_of(before), kind="stable")[:200])
    np.testing.assert_array_equal(after.means, before.means[kept])
    same = decimate.similarity(before, after, views, antialias=False)
    want = [psnr(*(np.clip(render(s, *v).rgb, 0, 1) for s in (before, after))) for v in views]
    assert same == pytest.approx(np.mean(want), abs=1e-6) and 10 < same < 45


def test_more_than_there_are_changes_nothing(scene: bpy.types.Scene) -> None:
    """Oracle: the count."""
    ob = lab.add(scene, lab.blob(30))
    bpy.context.view_layer.objects.active = ob
    assert bpy.ops.gscore.decimate_splats(count=30) == {"FINISHED"}
    assert len(ob.data.vertices) == 30
