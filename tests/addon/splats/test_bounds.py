"""Bounds of most splats; oracle: numpy's quantiles of all."""

from collections.abc import Callable

import bpy
import numpy as np
import pytest

from addon.core import Splats
from addon.splats import edit, objects, splat_framing


@pytest.mark.parametrize("most", [200_000, 400])
def test_in_world(
    scene: bpy.types.Scene,
    make_splats: Callable[..., Splats],
    monkeypatch: pytest.MonkeyPatch,
    most: int,
) -> None:
    """All of few splats; of many a sample, whose quantiles, box and frame are close."""
    monkeypatch.setattr(splat_framing, "_MOST", most)
    ob = objects.create(make_splats(3999), "chair")
    ob.rotation_euler, ob.scale, ob.location = (0.4, 0.7, -0.2), (3, 3, 3), (1, 2, 3)
    bpy.context.view_layer.update()
    matrix = np.array(ob.matrix_world, np.float64)
    everywhere = objects.read(ob).means @ matrix[:3, :3].T + matrix[:3, 3]
    found = splat_framing.in_world(ob)
    if most > 3999:
        np.testing.assert_allclose(found, everywhere, atol=1e-6)
    else:
        assert 200 < len(found) <= most
    size = np.ptp(everywhere)
    box = edit.add_crop_box(bpy.context, ob)
    low, high = np.quantile(everywhere, [0.005, 0.995], axis=0)
    np.testing.assert_allclose(box.location, (low + high) / 2, atol=0.05 * size)
    np.testing.assert_allclose(box.scale, (high - low) / 2, atol=0.05 * size)
