"""Lenses that bend lines, with numpy alone. Oracle: pycolmap's cameras."""

import numpy as np
import pycolmap
import pytest

from gscore.io.colmap.camera_models import MODELS_BY_NAME
from gscore.io.colmap.lenses import BENT, bent_pixels


@pytest.mark.parametrize("model", sorted(BENT))
def test_rays_meet_the_pixels_of_pycolmap(model: str) -> None:
    """Every parameter other than 0; rays up to 45 degrees aside, and the axis."""
    rng = np.random.default_rng(3)
    names = MODELS_BY_NAME[model].params
    known = {"f": 500.0, "fx": 500.0, "fy": 480.0, "cx": 310.0, "cy": 255.0}
    params = [known.get(name, rng.uniform(-0.05, 0.05)) for name in names]
    camera = pycolmap.Camera(model=model, width=640, height=480, params=params)
    rays = np.concatenate([rng.uniform(-0.7, 0.7, (200, 2)), np.zeros((1, 2))])
    wanted = camera.img_from_cam(np.concatenate([rays, np.ones((len(rays), 1))], axis=1))
    np.testing.assert_allclose(bent_pixels(model, params, rays), wanted, rtol=0, atol=1e-9)
