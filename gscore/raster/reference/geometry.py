"""Reference geometry: splat parameters to ellipses in the image, the stages of EWA splatting.

N splats, one camera. Camera frame: +x right, +y down, +z forward (OpenCV); pixel centres are at
+0.5. Every function is differentiable in its tensor arguments and keeps their dtype.

Sources: Zwicker, Pfister, van Baar and Gross, "EWA Volume Splatting", IEEE Visualization 2001
(local affine approximation of the projection, low-pass filter); Kerbl, Kopanas, Leimkühler and
Drettakis, "3D Gaussian Splatting for Real-Time Radiance Field Rendering", SIGGRAPH 2023, equations
4 to 6; Ye et al., "gsplat", arXiv 2409.06765 (clamped Jacobian, compensation).
"""

import torch
from torch import Tensor

from ...shared_constants import COMPENSATION_MIN, JACOBIAN_MARGIN


def quat_to_rotmat(quats: Tensor) -> Tensor:
    """Rotation matrices of quaternions of any non-zero length.

    Args:
        quats: [N, 4], wxyz; normalised here, so the gradient is orthogonal to the quaternion.

    Returns:
        [N, 3, 3]; columns are the splat's axes in the world.
    """
    w, x, y, z = (quats / quats.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
    ]
    return torch.stack(rows, -2)


def covariance(quats: Tensor, scales: Tensor) -> Tensor:
    """Covariance in the world, Sigma = R S S^T R^T (Kerbl et al. 2023, equation 6).

    Args:
        quats: [N, 4], wxyz.
        scales: [N, 3], standard deviations in world units (not logarithms).

    Returns:
        [N, 3, 3], symmetric, world units squared.
    """
    axes = (
        quat_to_rotmat(quats) * scales[:, None, :]
    )  # R S: each column is an axis of the ellipsoid
    return axes @ axes.transpose(-1, -2)


def means_to_camera(means: Tensor, viewmat: Tensor) -> Tensor:
    """Centres in the camera frame, p = R mean + t.

    Args:
        means: [N, 3], world units.
        viewmat: [4, 4], world to camera, column vectors; the last row is not read.

    Returns:
        [N, 3]; the last column is the depth z that orders the splats.
    """
    return means @ viewmat[:3, :3].T + viewmat[:3, 3]


def covariance_to_camera(covars: Tensor, viewmat: Tensor) -> Tensor:
    """Covariance in the camera frame, W Sigma W^T with W the rotation of the view matrix.

    Args:
        covars: [N, 3, 3], world.
        viewmat: [4, 4], world to camera.

    Returns:
        [N, 3, 3].
    """
    rotation = viewmat[:3, :3]
    return rotation @ covars @ rotation.T


def project_means(means_cam: Tensor, K: Tensor) -> Tensor:
    """Pinhole projection of the centres: exact, never clamped.

    Args:
        means_cam: [N, 3], camera frame, z > 0.
        K: [3, 3], pixels; fx, fy, cx, cy are read.

    Returns:
        [N, 2], pixels.
    """
    x, y, z = means_cam.unbind(-1)
    return torch.stack([K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]], -1)


def projection_jacobian(means_cam: Tensor, K: Tensor, width: int, height: int) -> Tensor:
    """Derivative of the projection at the centres (Zwicker et al. 2001, affine approximation).

    Far outside the image the affine approximation grows without bound and smears splats over the
    picture, so x/z and y/z are clamped to the image plus a margin of 0.3 tan(fov/2) on each side,
    measured from the principal point (arXiv 2409.06765 and gsplat 1.5.3). The clamp only affects
    this matrix; it is differentiated as written: a clamped x/z is a constant.

    Args:
        means_cam: [N, 3], camera frame, z > 0.
        K: [3, 3], pixels.
        width: pixels.
        height: pixels.

    Returns:
        [N, 2, 3], pixels per world unit.
    """
    x, y, z = means_cam.unbind(-1)
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    margin_x = JACOBIAN_MARGIN * 0.5 * width / fx
    margin_y = JACOBIAN_MARGIN * 0.5 * height / fy
    slope_x = (x / z).clamp(-(cx / fx + margin_x), (width - cx) / fx + margin_x)
    slope_y = (y / z).clamp(-(cy / fy + margin_y), (height - cy) / fy + margin_y)
    zero = torch.zeros_like(z)
    rows = [
        torch.stack([fx / z, zero, -fx * slope_x / z], -1),
        torch.stack([zero, fy / z, -fy * slope_y / z], -1),
    ]
    return torch.stack(rows, -2)


def project_parallel(means_cam: Tensor, K: Tensor) -> Tensor:
    """Orthographic projection of the centres, x = fx X + cx.

    Args:
        means_cam: [N, 3], camera frame.
        K: [3, 3], fx and fy in pixels per world unit.

    Returns:
        [N, 2], pixels.
    """
    return means_cam[:, :2] * K.diagonal()[:2] + K[:2, 2]


def parallel_jacobian(means_cam: Tensor, K: Tensor) -> Tensor:
    """Derivative of `project_parallel`, exact and equal for all splats.

    Args:
        means_cam: [N, 3], camera frame.
        K: [3, 3], fx and fy in pixels per world unit.

    Returns:
        [N, 2, 3], pixels per world unit.
    """
    jacobian = torch.zeros_like(K[:2])
    jacobian[0, 0], jacobian[1, 1] = K[0, 0], K[1, 1]
    return jacobian.expand(len(means_cam), 2, 3)


def project_covariance(covars_cam: Tensor, jacobian: Tensor) -> Tensor:
    """Covariance in the image, J W Sigma W^T J^T (Kerbl et al. 2023, equation 5).

    Args:
        covars_cam: [N, 3, 3], camera frame (W Sigma W^T).
        jacobian: [N, 2, 3].

    Returns:
        [N, 2, 2], pixels squared, before the low-pass filter.
    """
    return jacobian @ covars_cam @ jacobian.transpose(-1, -2)


def conic(covars2d: Tensor, eps2d: float) -> tuple[Tensor, Tensor]:
    """Inverse of the low-pass filtered covariance, and the opacity compensation.

    The low-pass filter (Zwicker et al. 2001, section on the resampling filter) adds `eps2d` to both
    variances. The compensation preserves a splat's integral: sqrt(det / det_filtered), at least
    0.005, without gradient at that floor.

    Args:
        covars2d: [N, 2, 2], pixels squared.
        eps2d: variance of the filter, pixels squared.

    Returns:
        conics [N, 3] as (xx, xy, yy) of the inverse, and compensation [N].
    """
    xx, xy, yy = covars2d[:, 0, 0], covars2d[:, 0, 1], covars2d[:, 1, 1]
    det_before = xx * yy - xy * xy
    xx, yy = xx + eps2d, yy + eps2d
    det = xx * yy - xy * xy
    compensation = (det_before / det).clamp(min=COMPENSATION_MIN**2).sqrt()
    return torch.stack([yy / det, -xy / det, xx / det], -1), compensation
