"""Discontinuity band: pixels at which two correct rasterizers may differ."""

from dataclasses import replace

import torch
from torch import Tensor

from ...shared_constants import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN
from ..request import Frustum, Settings
from .blending import PAIRS_PER_CHUNK, STOP_AT, gaussian_alpha, pixel_centers
from .rasterize import ProjectedSplats, SplatTensors, project


@torch.no_grad()
def boundary_band(
    splats: SplatTensors,
    view: Frustum,
    settings: Settings,
    *,
    alpha_tolerance: float = 1e-3,
    cap_tolerance: float = 1e-3,
    transmittance_tolerance: float = 1e-3,
    depth_tolerance: float = 1e-6,
    dtype: torch.dtype = torch.float64,
    pairs_per_chunk: int = PAIRS_PER_CHUNK,
) -> Tensor:
    """Mark the pixels whose value depends on a comparison that rounding could change.

    Only splats blended before the pixel stops count. A pixel is marked if

    - alpha is within `alpha_tolerance` (relative) of the threshold 1/255,
    - alpha before the cap is within `cap_tolerance` (relative) of 0.99,
    - the transmittance behind a splat is within `transmittance_tolerance` (relative) of 1e-4,
    - two neighbours in its blending order differ in z by less than `depth_tolerance` (relative),
    - a splat it blends has z within `depth_tolerance` (relative) of `near` or `far`.

    Args:
        splats, view, settings, dtype: as `project`.
        alpha_tolerance: |255 alpha - 1|.
        cap_tolerance: |alpha / 0.99 - 1|.
        transmittance_tolerance: |T (1 - alpha) / 1e-4 - 1|.
        depth_tolerance: |z_i - z_j| / z.
        pairs_per_chunk: as `rasterize_reference`.

    Returns:
        [H, W] bool.
    """
    near, far = view.near, view.far
    # Slightly wider depth limits, to include splats that are just culled.
    deeper = replace(view, near=near * (1 - depth_tolerance), far=far * (1 + depth_tolerance))
    faintest = ALPHA_MIN * (1 - alpha_tolerance)
    projected = project(splats, deeper, settings, dtype=dtype, min_opacity=faintest)
    pixels = pixel_centers(view.width, view.height, like=projected.means2d)
    at_limit = (projected.depths - near).abs() < depth_tolerance * near
    at_limit |= (projected.depths - far).abs() < depth_tolerance * far
    marks = []
    for part in pixels.split(max(1, pairs_per_chunk // max(1, len(projected.index)))):
        uncapped = gaussian_alpha(
            part, projected.means2d, projected.conics, projected.opacities
        )  # [P, M]
        drawn = uncapped >= ALPHA_MIN
        after = torch.cumprod(torch.where(drawn, 1 - uncapped.clamp(max=ALPHA_MAX), 1.0), 1)
        before = torch.cat([after.new_ones(len(part), 1), after], 1)[:, :-1]
        reached = before > STOP_AT
        marginal = (255 * uncapped - 1).abs() < alpha_tolerance
        marginal |= (uncapped / ALPHA_MAX - 1).abs() < cap_tolerance
        marginal |= drawn & ((after / TRANSMITTANCE_MIN - 1).abs() < transmittance_tolerance)
        marginal |= drawn & (at_limit | depth_ties(projected, drawn, depth_tolerance))
        marks.append((marginal & reached).any(1))
    return torch.cat(marks).reshape(view.height, view.width)


def depth_ties(splats: ProjectedSplats, drawn: Tensor, tolerance: float) -> Tensor:
    """[P, M] bool: the splat drawn before this one at the same pixel is at almost the same z."""
    z = splats.depths.expand(drawn.shape)
    latest = torch.where(drawn, z, -torch.inf).cummax(1).values  # z ascends: the last one drawn
    nothing = latest.new_full((len(drawn), 1), -torch.inf)
    previous = torch.cat([nothing, latest], 1)[:, :-1]
    return z - previous < tolerance * z
