"""A few splats in front of a camera, as float32 tensors."""

import numpy as np
import pytest
import torch

from gscore.raster.reference.rasterize import SplatTensors
from gscore.raster.request import Frustum


@pytest.fixture
def splats():
    """Forty translucent splats of some pixels, degree 3, some with colours above 1."""
    rng = np.random.default_rng(4)
    count = 40
    means = rng.uniform((-1, -0.7, 3.5), (1, 0.7, 5.0), (count, 3))
    arrays = (
        means,
        rng.normal(size=(count, 4)),
        rng.uniform(-3.2, -1.6, (count, 3)),
        rng.uniform(-2.5, 0.5, count),
        rng.uniform(-1.2, 2.2, (count, 1, 3)),
        rng.normal(0, 0.1, (count, 15, 3)),
    )
    return SplatTensors(*(torch.from_numpy(a.astype(np.float32)) for a in arrays))


@pytest.fixture
def view():
    """A camera of 40 x 30 px at the origin."""
    K = np.array([[48.0, 0, 20.5], [0, 47.0, 14.0], [0, 0, 1]])
    return Frustum(np.eye(4), K, 40, 30)
