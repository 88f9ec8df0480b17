"""Fewer spherical harmonics: colours that depend less on the view, and take less space."""

from dataclasses import replace

import numpy as np

from ..splats import SH_REST_BY_DEGREE, Splats


def narrow_sh(splats: Splats, degree: int) -> Splats:
    """The model with SH up to `degree` (0 to 3); one that has no more is given back as it is.

    Bands are orthogonal on the sphere, so what stays is the best that so few can do for a splat
    that is seen from all around.
    """
    kept = SH_REST_BY_DEGREE[degree]
    if splats.shN.shape[1] <= kept:
        return splats
    return replace(splats, shN=np.ascontiguousarray(splats.shN[:, :kept]))
