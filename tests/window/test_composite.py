"""Composites with EEVEE and a holdout mesh, in the window of a real Blender. Oracle: EEVEE's own
picture of the same meshes.

Needs the programs of `test_live.py`.
"""

import numpy as np
import pytest

from tests.window.scenes import run_scene

pytestmark = pytest.mark.window


def test_eevee_shows_no_world_in_holes(tmp_path_factory):
    """Oracle: the previous picture without splats, which comes back; splats in front of the hole
    are visible in it, and those behind are not."""
    found, _, output = run_scene("composite", tmp_path_factory, longest=400)
    assert "Traceback" not in output, output
    plain, meshes, whole, after = (
        np.array(found[name]) for name in ("plain", "meshes", "all", "after")
    )
    cut = plain[..., 3] < 1e-3
    assert 1000 < cut.sum() < 0.7 * cut.size and not meshes[cut].any()
    off = np.abs(meshes - plain)
    inside = np.isin(plain[..., 3].round(4), (0, 1))
    assert np.percentile(off[inside], 99) < 5e-3  # EEVEE's numbers are half floats
    assert off[..., 3].max() < 0.4 and off[..., 3].mean() < 5e-3
    row, red = whole[45], pytest.approx((0.787, 0.01, 0.01, 1), abs=0.02)
    assert cut[45, 39] and row[39] == red
    assert cut[45, 64] and not row[64].any()
    assert not cut[45, 76] and row[76] == red
    np.testing.assert_allclose(after, plain, atol=1e-3)
