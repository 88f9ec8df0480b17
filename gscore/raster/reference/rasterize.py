"""Reference rasterization: the whole chain from parameters and a camera to pictures."""

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from ...errors import ShapeError
from ...shared_constants import ALPHA_MIN, COLOR_MAX, EPS2D, QUAT_MIN
from ..request import Frustum, Settings
from .blending import PAIRS_PER_CHUNK, blend
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
)
from .harmonics import sh_colors

SH_COUNT_TO_DEGREE = {0: 0, 3: 1, 8: 2, 15: 3, 24: 4}


class SplatTensors(NamedTuple):
    """Parameters of N splats, raw or activated."""

    means: Tensor
    """[N, 3], world units."""
    quats: Tensor
    """[N, 4], wxyz, of any length."""
    scales: Tensor
    """[N, 3], standard deviations in world units or their logarithms."""
    opacities: Tensor
    """[N], 0 to 1 or logits."""
    sh0: Tensor
    """[N, 1, 3], constant SH coefficient."""
    shN: Tensor
    """[N, K-1, 3], K-1 = 0, 3, 8, 15 or 24."""

    def rows(self, index: Tensor) -> "SplatTensors":
        """The splats at these indices."""
        return SplatTensors(*(field[index] for field in self))


class ProjectedSplats(NamedTuple):
    """The M visible splats of a camera, front to back; ties in depth stay in input order."""

    index: Tensor
    """[M] int64, row of the input."""
    means2d: Tensor
    """[M, 2], pixels."""
    conics: Tensor
    """[M, 3], inverse image covariance (xx, xy, yy)."""
    opacities: Tensor
    """[M], activated; compensated if `antialias`."""
    colors: Tensor
    """[M, 3], RGB."""
    depths: Tensor
    """[M], camera z."""


class ReferenceOutput(NamedTuple):
    """Pictures of one camera, in the dtype of the computation."""

    rgb: Tensor
    """[H, W, 3], background included."""
    alpha: Tensor
    """[H, W], 1 minus the final transmittance."""
    inverse_depth: Tensor | None
    """[H, W], sum of weight / z (not divided by alpha)."""
    depth: Tensor | None
    """[H, W], expected depth: sum of weight * z / sum of weight; 0 where nothing was blended."""
    median_depth: Tensor | None
    """[H, W], z at which transmittance falls to 0.5, 0 where it never does; not differentiable."""


def check_inputs(splats: SplatTensors, view: Frustum, sh_degree: int | None) -> int:
    """Raise on invalid shapes and cameras; return the SH degree to use."""
    n, K = len(splats.means), view.K
    shapes = {
        "means": (splats.means, [n, 3]),
        "quats": (splats.quats, [n, 4]),
        "scales": (splats.scales, [n, 3]),
        "opacities": (splats.opacities, [n]),
        "sh0": (splats.sh0, [n, 1, 3]),
        "shN": (splats.shN, [n, *splats.shN.shape[1:2], 3]),
        "viewmat": (view.viewmat, [4, 4]),
        "K": (K, [3, 3]),
    }
    for name, (tensor, expected) in shapes.items():
        if list(tensor.shape) != expected:
            raise ShapeError(f"{name} must be {expected}, got {list(tensor.shape)}.")
    rest = splats.shN.shape[1]
    if rest not in SH_COUNT_TO_DEGREE:
        raise ShapeError(
            f"shN must have 0, 3, 8, 15 or 24 coefficients per splat (degree 0 to 4), got {rest}."
        )
    if view.width < 1 or view.height < 1:
        raise ShapeError(f"the image must be at least 1 x 1 px, got {view.width} x {view.height}.")
    zero_entries = [float(K[0, 1]), float(K[1, 0]), float(K[2, 0]), float(K[2, 1])]
    if any(zero_entries) or float(K[2, 2]) != 1 or not (K[0, 0] > 0 and K[1, 1] > 0):
        raise ShapeError(
            f"K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with positive fx and fy, "
            f"got {K.tolist()}; undistort the images to a pinhole camera without skew."
        )
    stored = SH_COUNT_TO_DEGREE[rest]
    degree = stored if sh_degree is None else sh_degree
    if not 0 <= degree <= stored:
        raise ShapeError(f"sh_degree must be 0 to {stored}, the degree stored, got {degree}.")
    return degree


def alive_rows(splats: SplatTensors, view: Frustum) -> Tensor:
    """[N] bool: rows with only finite parameters, a usable quaternion, and near < z <= far."""
    numbers = [field[:, None].flatten(1) for field in splats]
    finite = torch.cat(numbers, 1).isfinite()
    turned = splats.quats.abs().amax(1) >= QUAT_MIN
    z = means_to_camera(splats.means, view.viewmat)[:, 2]
    return finite.all(1) & turned & (z > view.near) & (z <= view.far)


def project_rows(
    splats: SplatTensors, view: Frustum, settings: Settings, sh_degree: int
) -> ProjectedSplats:
    """Activate, project and colour all rows; arguments as for `project`."""
    scales, opacities = splats.scales, splats.opacities
    if settings.raw:
        scales, opacities = scales.exp(), opacities.sigmoid()
    means_cam = means_to_camera(splats.means, view.viewmat)
    covars_cam = covariance_to_camera(covariance(splats.quats, scales), view.viewmat)
    if view.orthographic:
        means2d, jacobian = (f(means_cam, view.K) for f in (project_parallel, parallel_jacobian))
    else:
        means2d = project_means(means_cam, view.K)
        jacobian = projection_jacobian(means_cam, view.K, view.width, view.height)
    conics, compensation = conic(project_covariance(covars_cam, jacobian), settings.eps2d)
    return ProjectedSplats(
        index=torch.arange(len(means_cam), device=means_cam.device),
        means2d=means2d,
        conics=conics,
        opacities=opacities * compensation if settings.antialias else opacities,
        colors=sh_colors(
            splats.means,
            view.viewmat,
            splats.sh0,
            splats.shN,
            sh_degree,
            orthographic=view.orthographic,
        ),
        depths=means_cam[:, 2],
    )


def project(
    splats: SplatTensors,
    view: Frustum,
    settings: Settings,
    *,
    dtype: torch.dtype = torch.float64,
    min_opacity: float = ALPHA_MIN,
) -> ProjectedSplats:
    """Per-splat part of the pipeline: cull, activate, project, colour, sort.

    `dtype` is as for `rasterize_reference`; `min_opacity` is the opacity below which a splat cannot
    reach the alpha threshold. Culling is decided first, without gradients, and culled rows are left
    out of the differentiated chain: they get an exact zero gradient, and a NaN or overflow in one
    row does not affect others or the camera.
    """
    degree = check_inputs(splats, view, settings.sh_degree)
    splats = SplatTensors(*(field.to(dtype) for field in splats))
    view = replace(view, viewmat=view.viewmat.to(dtype), K=view.K.to(dtype))

    def chain(index: Tensor) -> ProjectedSplats:
        return project_rows(splats.rows(index), view, settings, degree)

    with torch.no_grad():
        index = alive_rows(splats, view).nonzero()[:, 0]
        tried = chain(index)
        finite = torch.cat([tried.means2d, tried.conics, tried.colors], 1).isfinite().all(1)
        finite &= (tried.colors <= COLOR_MAX).all(1)
        ellipse = (tried.conics[:, 0] > 0) & (tried.conics[:, 2] > 0)  # not lost to rounding
        kept = (finite & ellipse & (tried.opacities >= min_opacity)).nonzero()[:, 0]
        kept = kept[tried.depths[kept].argsort(stable=True)]
        index = index[kept]
    return chain(index)._replace(index=index)


def composite(
    splats: ProjectedSplats,
    width: int,
    height: int,
    *,
    background: Tensor | None = None,
    far_depths: Tensor | None = None,
    inverse_depth: bool = False,
    depth: bool = False,
    pairs_per_chunk: int = PAIRS_PER_CHUNK,
) -> ReferenceOutput:
    """Per-pixel part of the pipeline: blend colour and depth, add the background.

    Arguments as for `rasterize_reference`. Colour, 1/z, z and 1 are blended as features.
    """
    z = splats.depths[:, None]
    blended = blend(
        splats.means2d,
        splats.conics,
        splats.opacities,
        splats.depths,
        torch.cat([splats.colors, 1 / z, z, torch.ones_like(z)], 1),
        width=width,
        height=height,
        far_depths=far_depths,
        pairs_per_chunk=pairs_per_chunk,
    )
    rgb, inverse, depth_sum, weight = blended.sums.split([3, 1, 1, 1], 1)
    if background is not None:
        rgb = rgb + blended.transmittance[:, None] * background.to(rgb).detach()
    expected = torch.where(weight > 0, depth_sum / torch.where(weight > 0, weight, 1.0), 0.0)
    return ReferenceOutput(
        rgb=rgb.reshape(height, width, 3),
        alpha=(1 - blended.transmittance).reshape(height, width),
        inverse_depth=inverse.reshape(height, width) if inverse_depth else None,
        depth=expected.reshape(height, width) if depth else None,
        median_depth=blended.median_depth.reshape(height, width) if depth else None,
    )


def rasterize_reference(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    sh0: Tensor,
    shN: Tensor,
    viewmat: Tensor,
    K: Tensor,
    width: int,
    height: int,
    *,
    raw: bool = False,
    sh_degree: int | None = None,
    background: Tensor | None = None,
    near: float = 0.01,
    far: float = 1e10,
    eps2d: float = EPS2D,
    antialias: bool = False,
    orthographic: bool = False,
    far_depths: Tensor | None = None,
    inverse_depth: bool = False,
    depth: bool = False,
    dtype: torch.dtype = torch.float64,
    pairs_per_chunk: int = PAIRS_PER_CHUNK,
) -> ReferenceOutput:
    """Rasterize N splats for one camera: slow, exact, differentiable by plain autograd.

    Differentiable in means, quats, scales, opacities, sh0, shN and viewmat; the viewmat gradient
    is the full chain through position, covariance and SH direction, entry by entry of the upper
    three rows, with the camera centre taken as -R^T t.

    Args:
        means: [N, 3], world units.
        quats: [N, 4], wxyz, of any length; splats without a component of QUAT_MIN are not drawn.
        scales: [N, 3], standard deviations in world units, or their logarithms if `raw`.
        opacities: [N], 0 to 1, or logits if `raw`.
        sh0: [N, 1, 3], constant SH coefficient.
        shN: [N, K-1, 3], K-1 = 0, 3, 8, 15 or 24.
        viewmat: [4, 4], rigid, world to camera, OpenCV axes, column vectors.
        K: [3, 3], pixels, no skew; pixel centres at +0.5.
        width: pixels.
        height: pixels.
        raw: whether scales and opacities are the raw parameters of a 3DGS file.
        sh_degree: SH degree to use, at most the stored one; None: the stored one.
        background: [3], RGB background colour, constant; None: black.
        near: splats with z <= near are not drawn, world units.
        far: splats with z > far are not drawn, world units.
        eps2d: variance added in the image, pixels squared.
        antialias: multiply opacities by the compensation of `eps2d`.
        orthographic: parallel rays; K's focal lengths are pixels per world unit.
        far_depths: [H, W], splats with z above it are not drawn at a pixel; NaN or None: all are.
        inverse_depth: whether to return the accumulated inverse depth.
        depth: whether to return expected and median depth.
        dtype: floating dtype to compute in; inputs of another are converted.
        pairs_per_chunk: splat-pixel pairs per chunk, a memory limit.

    Returns:
        The pictures in `dtype`.

    Raises:
        ShapeError: an input has a wrong shape, the image no pixels, K has skew or no focal length,
            or sh_degree exceeds the stored one.
    """
    splats = project(
        SplatTensors(means, quats, scales, opacities, sh0, shN),
        Frustum(viewmat, K, width, height, near, far, orthographic),
        Settings(raw=raw, sh_degree=sh_degree, eps2d=eps2d, antialias=antialias),
        dtype=dtype,
    )
    return composite(
        splats,
        width,
        height,
        background=background,
        far_depths=far_depths,
        inverse_depth=inverse_depth,
        depth=depth,
        pairs_per_chunk=pairs_per_chunk,
    )
