"""Reference rasterizer: the definition in plain torch and float64; slow, written for clarity.

The native library computes the same in float32. A difference outside `boundary_band` is an error in
one of them.
"""

from .band import boundary_band
from .blending import Blended, blend, blend_pixels, gaussian_alpha, pixel_centers
from .geometry import (
    conic,
    covariance,
    covariance_to_camera,
    means_to_camera,
    parallel_jacobian,
    project_covariance,
    project_means,
    project_parallel,
    projection_jacobian,
    quat_to_rotmat,
)
from .harmonics import sh_basis, sh_colors
from .loss import image_loss_reference, unexposed_reference
from .rasterize import (
    ProjectedSplats,
    ReferenceOutput,
    SplatTensors,
    composite,
    project,
    rasterize_reference,
)
