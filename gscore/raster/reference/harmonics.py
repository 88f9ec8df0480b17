"""Reference spherical harmonics: view-dependent colour in the sign convention of 3DGS.

Order (l, m): (0,0), (1,-1), (1,0), (1,1), (2,-2), ... with the Condon-Shortley phase, so functions
of odd m have a minus sign: degree 1 is -y, z, -x. Constants are in closed form. Source: Kerbl et
al. 2023, section 4; any table of real spherical harmonics.
"""

from math import pi, sqrt

import torch
from torch import Tensor


def sh_basis(directions: Tensor, degree: int) -> Tensor:
    """Values of the basis functions, polynomials on the unit sphere.

    Args:
        directions: [N, 3], unit length.
        degree: 0 to 4.

    Returns:
        [N, (degree + 1)^2].
    """
    x, y, z = directions.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    values = [torch.full_like(x, sqrt(1 / (4 * pi)))]
    if degree >= 1:
        c = sqrt(3 / (4 * pi))
        values += [-c * y, c * z, -c * x]
    if degree >= 2:
        c = sqrt(15 / (4 * pi))
        values += [
            c * x * y,
            -c * y * z,
            sqrt(5 / (16 * pi)) * (2 * zz - xx - yy),
            -c * x * z,
            c / 2 * (xx - yy),
        ]
    if degree >= 3:
        c1, c2, c3 = sqrt(21 / (32 * pi)), sqrt(105 / (4 * pi)), sqrt(35 / (32 * pi))
        values += [
            -c3 * y * (3 * xx - yy),
            c2 * x * y * z,
            -c1 * y * (4 * zz - xx - yy),
            sqrt(7 / (16 * pi)) * z * (2 * zz - 3 * xx - 3 * yy),
            -c1 * x * (4 * zz - xx - yy),
            c2 / 2 * z * (xx - yy),
            -c3 * x * (xx - 3 * yy),
        ]
    if degree >= 4:
        c1, c2 = sqrt(45 / (32 * pi)), sqrt(45 / (16 * pi))
        c3, c4 = sqrt(315 / (32 * pi)), sqrt(315 / (16 * pi))
        values += [
            c4 * x * y * (xx - yy),
            -c3 * y * z * (3 * xx - yy),
            c2 * x * y * (6 * zz - xx - yy),
            -c1 * y * z * (4 * zz - 3 * xx - 3 * yy),
            sqrt(9 / (256 * pi)) * (8 * zz**2 - 24 * zz * (xx + yy) + 3 * (xx + yy) ** 2),
            -c1 * x * z * (4 * zz - 3 * xx - 3 * yy),
            c2 / 2 * (xx - yy) * (6 * zz - xx - yy),
            -c3 * x * z * (xx - 3 * yy),
            c4 / 4 * (xx**2 - 6 * xx * yy + yy**2),
        ]
    return torch.stack(values, -1)


def sh_colors(
    means: Tensor,
    viewmat: Tensor,
    sh0: Tensor,
    shN: Tensor,
    degree: int,
    *,
    orthographic: bool = False,
) -> Tensor:
    """View-dependent colour of each splat, max(0, 0.5 + SH(direction)).

    The direction is from the camera centre, -R^T t, to the splat. Colours clamped at 0 pass no
    gradient.

    Args:
        means: [N, 3], world units.
        viewmat: [4, 4], world to camera, rigid.
        sh0: [N, 1, 3].
        shN: [N, K-1, 3]; only the first (degree + 1)^2 - 1 coefficients are read.
        degree: 0 to 4.
        orthographic: whether the direction is the camera's +z for all splats instead.

    Returns:
        [N, 3], RGB, not bounded above.
    """
    rotation, translation = viewmat[:3, :3], viewmat[:3, 3]
    offsets = rotation[2].expand_as(means) if orthographic else means + rotation.T @ translation
    directions = offsets / offsets.norm(dim=-1, keepdim=True)
    basis = sh_basis(directions, degree)  # [N, K]
    coefficients = torch.cat([sh0, shN], 1)[:, : basis.shape[1]]  # [N, K, 3]
    return torch.relu(0.5 + (basis[:, :, None] * coefficients).sum(1))
