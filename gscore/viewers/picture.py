"""Pictures by a viewer's rules: the definition in float64, and a fast differentiable drawing."""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from ..raster.autograd import rasterize
from ..raster.gpu.gpu_raster import GpuRaster
from ..raster.reference.geometry import (
    covariance,
    covariance_to_camera,
    means_to_camera,
    project_covariance,
    project_means,
    projection_jacobian,
)
from ..raster.reference.harmonics import sh_colors
from ..raster.reference.rasterize import SH_COUNT_TO_DEGREE, SplatTensors
from ..raster.request import Frustum
from ..shared_constants import COMPENSATION_MIN, QUAT_MIN, SH_C0
from .coding import rounded, stored
from .light import to_linear, to_srgb
from .rules import ViewerRules

_BAND = 1 << 22
"""Splat-pixel pairs per band of rows, a memory limit: some 300 MB."""
_KEYS = 1 << 16
"""Pixels per band of rows: numbers of 16 bits, which numpy sorts in linear time."""
_OPAQUE = 1 - 1e-12
"""Largest opacity, which keeps logarithms finite."""
_FAINT = 1e-5
"""Opacity at which a splat without an end is cut."""


@dataclass(frozen=True)
class _Ellipses:
    """M visible splats of a view in the order of blending, float64."""

    means2d: Tensor
    """[M, 2], px."""
    axes: Tensor
    """[M, 2, 2], columns: unit vectors of the axes."""
    sigmas: Tensor
    """[M, 2], standard deviations along them, px."""
    opacities: Tensor
    """[M]."""
    colors: Tensor
    """[M, 3], as blended."""


def modelled_picture(
    splats: SplatTensors,
    view: Frustum,
    rules: ViewerRules,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Tensor:
    """The picture of a viewer by its rules, in float64.

    Not modelled: rotations as stored, 8-bit render targets, tone mapping, temporal noise.

    Args:
        splats: Raw parameters of N splats.
        view: Camera of any dtype.
        rules: Of the viewer.
        background: sRGB.

    Returns:
        [H, W, 3] float64, sRGB, in 0 to 1.
    """
    with torch.no_grad():
        view = replace(
            view,
            viewmat=torch.as_tensor(view.viewmat, dtype=torch.float64, device="cpu"),
            K=torch.as_tensor(view.K, dtype=torch.float64, device="cpu"),
        )
        fields = SplatTensors(*(field.detach().double() for field in splats))
        ellipses = _projected(stored(fields, rules), view, rules)
        over = fields.means.new_tensor(background)
        over = to_linear(over) if rules.linear else over
        rows = [
            _blended(ellipses, view.width, top, bottom, rules, over)
            for top, bottom in _bands(ellipses, view.width, view.height, rules)
        ]
        picture = torch.cat(rows)
        return (to_srgb(picture) if rules.linear else picture).clamp(0, 1)


def drawn_picture(
    splats: SplatTensors,
    view: Frustum,
    rules: ViewerRules,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    threads: int = 0,
    device: GpuRaster | None = None,
) -> Tensor:
    """`modelled_picture` by the native rasterizer: float32, differentiable in scales, opacities,
    sh0 and shN, not clamped at 1.

    It ends splats where their opacity falls below 1/255 instead of at `reach`, and limits opacities
    to 0.99. Splats with a shifted falloff are narrowed to the same integral.

    Args:
        splats: Raw parameters of N splats, float32.
        view: Camera.
        rules: Of the viewer.
        background: sRGB.
        threads: 0: all cores.
        device: An open device that draws; None: the CPU.

    Returns:
        [H, W, 3] float32, sRGB.
    """
    decoded = stored(splats, rules)
    viewmat = torch.as_tensor(view.viewmat, dtype=torch.float32, device="cpu")
    colors = _colors(decoded, viewmat, rules)
    seen = decoded.opacities >= rules.opacity_min
    over = torch.tensor(background, dtype=torch.float32, device="cpu")
    over = to_linear(over) if rules.linear else over
    means, scales = _at_distances(decoded, viewmat) if rules.radial else decoded[:3:2]
    share = _integral_share(rules)
    rgb = rasterize(
        means,
        decoded.quats,
        scales * rules.widening * math.sqrt(share),
        torch.where(seen, decoded.opacities * rules.alpha_gain, 0.0).clamp(max=1.0),
        (colors[:, None] - 0.5) / SH_C0,
        decoded.shN[:, :0],
        viewmat,
        torch.as_tensor(view.K, dtype=torch.float32, device="cpu"),
        view.width,
        view.height,
        background=over,
        near=view.near,
        eps2d=rules.eps2d * share,
        antialias=rules.compensated,
        threads=threads,
        device=device,
    ).rgb
    return to_srgb(rgb) if rules.linear else rgb


def _at_distances(splats: SplatTensors, viewmat: Tensor) -> tuple[Tensor, Tensor]:
    """Means and scales of splats enlarged about the camera until their z is their distance from
    it: the same ellipses in the image, in the order of the distances."""
    center = -viewmat[:3, :3].T @ viewmat[:3, 3]
    away = splats.means - center
    z = away @ viewmat[2, :3]
    factor = torch.where(z > 0, away.norm(dim=1) / z, 1.0)[:, None]
    return center + away * factor, splats.scales * factor


def _integral_share(rules: ViewerRules) -> float:
    """Integral of the falloff relative to that of the same Gaussian, if it is shifted; else 1."""
    if not rules.shifted:
        return 1.0
    last = math.exp(-(rules.reach**2) / 2)
    return 1 - rules.reach**2 / 2 * last / (1 - last)


def _colors(splats: SplatTensors, viewmat: Tensor, rules: ViewerRules) -> Tensor:
    """[N, 3] colours as blended."""
    degree = SH_COUNT_TO_DEGREE[splats.shN.shape[1]]
    colors = sh_colors(splats.means, viewmat, splats.sh0, splats.shN, degree)
    colors = colors.clamp(max=rules.color_max)
    if rules.color_steps:
        colors = rounded(colors, rules.color_steps)
    return to_linear(colors) if rules.linear else colors


def _projected(splats: SplatTensors, view: Frustum, rules: ViewerRules) -> _Ellipses:
    """Visible splats, decoded by `stored`, in the image."""
    turned = splats.quats.abs().amax(1) >= QUAT_MIN
    means = means_to_camera(splats.means, view.viewmat)
    kept = turned & (means[:, 2] > view.near) & (splats.opacities >= rules.opacity_min)
    order = means.norm(dim=1) if rules.radial else means[:, 2]
    index = kept.nonzero()[:, 0]
    index = index[order[index].argsort(stable=True)]
    splats, means = splats.rows(index), means[index]
    covars = covariance_to_camera(covariance(splats.quats, splats.scales), view.viewmat)
    jacobian = projection_jacobian(means, view.K, view.width, view.height)
    before = project_covariance(covars, jacobian) * rules.widening**2
    after = before + rules.eps2d * torch.eye(2, dtype=before.dtype, device="cpu")
    variances, axes = torch.linalg.eigh(after)
    opacities = splats.opacities
    if rules.compensated:
        share = (torch.linalg.det(before) / variances.prod(1)).clamp(min=COMPENSATION_MIN**2)
        opacities = opacities * share.sqrt()
    return _Ellipses(
        means2d=project_means(means, view.K),
        axes=axes,
        sigmas=variances.clamp(min=0).sqrt(),
        opacities=opacities,
        colors=_colors(splats, view.viewmat, rules),
    )


def _reaches(ellipses: _Ellipses, rules: ViewerRules) -> Tensor:
    """[M] standard deviations that are drawn."""
    faintest = max(rules.alpha_min, _FAINT)
    visible = (2 * (ellipses.opacities * rules.alpha_gain / faintest).clamp(min=1).log()).sqrt()
    ends = rules.reach * (math.sqrt(2) if rules.square else 1)
    return visible.clamp(max=ends)


def _boxes(ellipses: _Ellipses, rules: ViewerRules) -> tuple[Tensor, Tensor]:
    """[M, 2] int64: first pixels of the bounding boxes, and the pixels after the last."""
    half = (ellipses.axes * ellipses.sigmas[:, None]).norm(dim=2) * _reaches(ellipses, rules)[
        :, None
    ]
    low = (ellipses.means2d - half - 0.5).ceil().clamp(-1e9, 1e9).long()
    high = (ellipses.means2d + half - 0.5).floor().clamp(-1e9, 1e9).long() + 1
    return low, high


def _bands(
    ellipses: _Ellipses, width: int, height: int, rules: ViewerRules
) -> list[tuple[int, int]]:
    """Ranges of rows with at most about `_BAND` pairs and `_KEYS` pixels each."""
    low, high = (corner.clamp(min=0) for corner in _boxes(ellipses, rules))
    wide = (high[:, 0] - low[:, 0]).clamp(0, 1 << 14)
    change = torch.zeros(height + 1, dtype=torch.int64, device="cpu")
    change.index_add_(0, low[:, 1].clamp(max=height), wide)
    change.index_add_(0, torch.maximum(high[:, 1], low[:, 1]).clamp(max=height), -wide)
    bands, top, pairs = [], 0, 0
    for row, count in enumerate(change.cumsum(0)[:height].tolist()):
        if row > top and (pairs + count > _BAND or (row + 1 - top) * width > _KEYS):
            bands.append((top, row))
            top, pairs = row, 0
        pairs += count
    return [*bands, (top, height)]


def _pairs(
    ellipses: _Ellipses, width: int, top: int, bottom: int, rules: ViewerRules
) -> tuple[Tensor, Tensor, Tensor]:
    """Splats, columns and rows of all pixels in the bounding boxes, in the order of blending."""
    low, high = _boxes(ellipses, rules)
    ends = torch.tensor([width, bottom], dtype=torch.int64, device="cpu")
    low = torch.maximum(low, torch.tensor([0, top], dtype=torch.int64, device="cpu"))
    sides = (torch.minimum(high, ends) - low).clamp(min=0)
    counts = sides.prod(1)
    splat = torch.arange(len(counts), dtype=torch.int64, device="cpu").repeat_interleave(counts)
    place = (
        torch.arange(len(splat), dtype=torch.int64, device="cpu")
        - (counts.cumsum(0) - counts)[splat]
    )
    wide = sides[splat, 0]
    return splat, low[splat, 0] + place % wide, low[splat, 1] + place // wide


def _blended(
    ellipses: _Ellipses,
    width: int,
    top: int,
    bottom: int,
    rules: ViewerRules,
    background: Tensor,
) -> Tensor:
    """[bottom - top, W, 3] rows of the picture, before its conversion to sRGB."""
    splat, x, y = _pairs(ellipses, width, top, bottom, rules)
    away = torch.stack([x, y], 1) + 0.5 - ellipses.means2d[splat]
    along = (away[:, None] @ (ellipses.axes / ellipses.sigmas[:, None])[splat])[:, 0]
    alpha = _falloff(along, rules) * (ellipses.opacities * rules.alpha_gain)[splat]
    drawn = (alpha >= max(rules.alpha_min, _FAINT)).nonzero()[:, 0]
    pixel = ((y - top) * width + x)[drawn]
    keys = pixel.numpy().astype(np.uint16 if (bottom - top) * width <= _KEYS else np.int64)
    order = torch.from_numpy(keys.argsort(kind="stable"))
    pixel, drawn = pixel[order], drawn[order]
    alpha, splat = alpha[drawn].clamp(max=_OPAQUE), splat[drawn]
    passed = torch.log1p(-alpha)
    through = passed.cumsum(0) - passed
    counts = torch.bincount(pixel, minlength=(bottom - top) * width)
    firsts = (counts.cumsum(0) - counts)[pixel]
    weights = alpha * (through - through[firsts]).exp()
    picture = alpha.new_zeros(len(counts), 3)
    picture.index_add_(0, pixel, weights[:, None] * ellipses.colors[splat])
    covered = alpha.new_zeros(len(counts)).index_add_(0, pixel, weights)
    return (picture + (1 - covered)[:, None] * background).reshape(bottom - top, width, 3)


def _falloff(along: Tensor, rules: ViewerRules) -> Tensor:
    """[P] share of the opacity at [P, 2] standard deviations along the axes."""
    square = (along * along).sum(1)
    share = torch.exp(-square / 2)
    if rules.shifted:
        last = math.exp(-(rules.reach**2) / 2)
        share = (share - last) / (1 - last)
    inside = along.abs().amax(1) if rules.square else square.sqrt()
    return torch.where(inside <= rules.reach, share, 0.0)
