"""Small training: two steps that use most kernels, repeated to find out whether a device still
computes the same."""

import hashlib
from typing import Any

import numpy as np

from ...raster.request import Frustum
from ...splats import PARAMETERS, SH_REST_BY_DEGREE
from ..base import Engine, ShUpdate, StepPhoto, StepRequest, TermKind

_SPLATS, _SIDE, _DEGREE = 100, 40, 3
_PHOTO = -1
"""Number of its photo, which no view has."""


def small_training(engine: Engine[Any]) -> bytes:
    """Take two steps with a model of their own; returns the hash of all that they have written.

    Raises:
        BackendError: the engine failed.
    """
    random = np.random.default_rng(0)
    n, side = _SPLATS, _SIDE
    columns = {
        "means": random.uniform((-1, -1, 2), (1, 1, 4), (n, 3)),
        "quats": random.normal(size=(n, 4)),
        "scales": np.log(random.uniform(0.02, 0.3, (n, 3))),
        "opacities": random.normal(size=n),
        "sh0": random.normal(size=(n, 1, 3)),
        "shN": 0.2 * random.normal(size=(n, SH_REST_BY_DEGREE[_DEGREE], 3)),
    }
    columns = {name: column.astype(np.float32) for name, column in columns.items()}
    image, mask = (random.integers(0, 256, (side, side, *rgb), np.uint8) for rgb in ((3,), ()))
    photo = StepPhoto(image=image, mask=mask, mask_mode="composite")
    K = np.array([[side, 0, side / 2], [0, side, side / 2], [0, 0, 1.0]])
    counters = ("grad2d", "views")
    model = engine.model(columns, counters=counters)
    content = hashlib.sha256()
    for update in (ShUpdate.ACCUMULATE, ShUpdate.STEP):
        engine.put(_PHOTO, photo)
        request = StepRequest(
            step=0,
            photo=_PHOTO,
            view=Frustum(np.eye(4), K, side, side),
            background=(0.1, 0.5, 0.9),
            shown_background=(0.2, 0.5, 0.8),
            antialias=True,
            sh_degree=_DEGREE,
            sh_update=update,
            rates=dict.fromkeys(PARAMETERS, 1e-3),
            terms=((TermKind.L1, 0.8), (TermKind.SSIM, 0.2), (TermKind.MASK_ALPHA, 0.1)),
            observe=counters,
            gain=(0.9, 1.1, 1.0),
            blur=(2.0, 0.5, 1.0),
            learn_pose=True,
            drop_rate=0.1,
            noise=1e-3,
            opacity_reg=0.01,
            scale_reg=0.01,
            extent=1.0,
        )
        numbers = engine.step(model, request).result()
        content.update(numbers.slopes.tobytes() + np.float64(numbers.loss).tobytes())
    for name, column in sorted(model.save().items()):
        content.update(name.encode() + column.tobytes())
    model.close()
    return content.digest()
