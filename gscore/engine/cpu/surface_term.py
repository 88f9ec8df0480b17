"""Surface terms of a step: splats become flat and lie on the surface (2DGS, Huang et al. 2024).

With w the weights of the splats of a pixel, A their sum, n their normals, z their depths:

    normals      A - (sum of w n) . N, where N is the normal of the mean depth of nearby pixels
    distortion   (sum of w z) (sum of w / z) - A^2, half the sum of w_i w_j (z_i - z_j)^2 / z_i z_j
    flatness     mean over splats of shortest / middle scale

The first two are means over pixels of a picture of half the size, drawn a second time with normals
as colours: pixels of the photo's size show single splats rather than the surface.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from ...raster.blend_weights import GEOMETRY
from ...raster.header import TILE
from ...raster.normals import NormalPicture, rasterize_normals
from ...raster.request import Frustum
from ..base import StepPhoto

NORMALS, DISTORTION, FLATNESS = 0.05, 100.0, 0.01
"""Weights of the terms; at the end of a training they are a fifth of the photometric loss."""
DIVISOR = 2
"""Size of the photo relative to that of the picture."""
_STEEPEST = 6.0
"""Largest change of depth between pixels, as a multiple of a pixel's width on the surface: beyond
it there is a silhouette."""
_OPAQUE = 0.5
"""Alpha above which a pixel has a normal."""


class SurfaceTerms(NamedTuple):
    """The weighted terms of a step."""

    value: float
    """Their sum."""
    gradients: Mapping[str, Tensor]
    """Its gradients in the raw parameters of `GEOMETRY`."""


def surface_terms(
    splats: Mapping[str, Tensor],
    photo: StepPhoto,
    view: Frustum,
    weight: float,
    *,
    frozen: Mapping[str, Tensor] | None = None,
    antialias: bool,
    threads: int,
) -> SurfaceTerms:
    """Compute the terms of a view.

    Args:
        splats: Raw parameters.
        photo: Its photo, whose `ignore` mask weights the pixels.
        view: Camera of the photo.
        weight: Factor of all terms.
        frozen: Raw parameters of splats that are drawn too; None: none.
        antialias: As in `rasterize`.
        threads: CPU threads; 0: all cores.
    """
    leaves = {name: splats[name].detach().requires_grad_() for name in GEOMETRY}
    drawn = leaves
    if frozen is not None:
        drawn = {name: torch.cat([frozen[name], leaf]) for name, leaf in leaves.items()}
    small = smaller(view)
    picture = rasterize_normals(
        drawn["means"],
        drawn["quats"],
        drawn["scales"],
        drawn["opacities"],
        small.viewmat,
        small.K,
        small.width,
        small.height,
        raw=True,
        near=small.near,
        antialias=antialias,
        threads=threads,
        inverse_depth=True,
        depth=True,
        tiles=_smaller_tiles(photo.tiles, small),
    )
    normals, distortion = picture_terms(picture, small.K, _weights(photo, small))
    value = weight * (NORMALS * normals + DISTORTION * distortion)
    found = torch.autograd.grad(value, tuple(leaves.values()))
    gradients = dict(zip(leaves, found, strict=True))
    flatness, slopes = flatness_term(splats["scales"])
    gradients["scales"] += weight * FLATNESS * slopes
    return SurfaceTerms(value.item() + weight * FLATNESS * flatness, gradients)


def picture_terms(
    picture: NormalPicture, K: Tensor, weights: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Terms of normals and distortion, see the module; differentiable.

    Args:
        picture: Normals, alpha and depths, [H, W, ...].
        K: [3, 3] px.
        weights: [H, W] of the pixels; None: 1.
    """
    alpha, depth = picture.alpha, picture.depth
    assert depth is not None
    assert picture.inverse_depth is not None
    height, width = alpha.shape
    x = torch.arange(width, dtype=alpha.dtype, device=alpha.device) + 0.5
    y = torch.arange(height, dtype=alpha.dtype, device=alpha.device)[:, None] + 0.5
    columns, rows = (x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1]
    places = torch.stack([depth * columns, depth * rows, depth], dim=-1)
    across = places[1:-1, 2:] - places[1:-1, :-2]
    down = places[2:, 1:-1] - places[:-2, 1:-1]
    surface = normalize(torch.linalg.cross(down, across, dim=-1), dim=-1)
    inner = (slice(1, -1), slice(1, -1))
    with torch.no_grad():
        change = torch.maximum(across[..., 2].abs(), down[..., 2].abs())
        counted = (alpha > _OPAQUE)[inner] & (change < 2 * _STEEPEST * depth[inner] / K[0, 0])
        counted = counted.to(alpha.dtype)
    bent = counted * (alpha[inner] - (picture.normals[inner] * surface).sum(dim=-1))
    spread = alpha * depth * picture.inverse_depth - alpha * alpha
    if weights is not None:
        bent, spread = bent * weights[inner], spread * weights
    return bent.sum() / alpha.numel(), spread.mean()


def flatness_term(scales: Tensor) -> tuple[float, Tensor]:
    """Mean ratio of shortest and middle scale, and its gradient [N, 3] in the shortest only.

    Args:
        scales: [N, 3] logarithms.
    """
    slopes = torch.zeros_like(scales)
    if len(scales) == 0:
        return 0.0, slopes
    ordered, axes = scales.detach().sort(dim=1)
    ratios = (ordered[:, :1] - ordered[:, 1:2]).exp() / len(scales)
    return float(ratios.sum()), slopes.scatter_(1, axes[:, :1], ratios)


def smaller(view: Frustum) -> Frustum:
    """The view with a picture of 1 / `DIVISOR` of its sides."""
    K, viewmat = (
        torch.from_numpy(matrix.copy()) if isinstance(matrix, np.ndarray) else matrix.clone()
        for matrix in (view.K, view.viewmat)
    )
    K[:2] /= DIVISOR
    width, height = (max(side // DIVISOR, 3) for side in (view.width, view.height))
    return replace(view, viewmat=viewmat, K=K, width=width, height=height)


def _smaller_tiles(tiles: np.ndarray | None, view: Frustum) -> Tensor | None:
    """The tiles of a smaller picture that contain tiles [Y, X] uint8 of the photo's size."""
    if tiles is None:
        return None
    rows, columns = -(-view.height // TILE), -(-view.width // TILE)
    padded = np.zeros((rows * DIVISOR, columns * DIVISOR), np.uint8)
    cut = tiles[: padded.shape[0], : padded.shape[1]]
    padded[: cut.shape[0], : cut.shape[1]] = cut
    return torch.from_numpy(padded.reshape(rows, DIVISOR, columns, DIVISOR).max(axis=(1, 3)))


def _weights(photo: StepPhoto, view: Frustum) -> Tensor | None:
    """[H, W] float32 of an `ignore` mask; None: all pixels count."""
    if photo.mask is None or photo.mask_mode != "ignore":
        return None
    rows = np.minimum(DIVISOR * np.arange(view.height), photo.mask.shape[0] - 1)
    columns = np.minimum(DIVISOR * np.arange(view.width), photo.mask.shape[1] - 1)
    return torch.from_numpy(photo.mask[np.ix_(rows, columns)].astype(np.float32) / 255)
