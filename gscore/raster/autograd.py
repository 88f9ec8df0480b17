"""The native rasterizer as a differentiable torch function: one camera a call, float32, CPU."""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..splats import PARAMETERS
from . import _native
from .calls import Picture, Settings, backward, check_splats, check_tiles, forward


@dataclass
class RasterAux:
    """By-products a strategy needs, filled by the call it is passed to."""

    radii: Tensor | None = None
    """[N] int32 after forward: half the larger side of a splat's box in px, 0 = culled."""
    v_means2d: Tensor | None = None
    """[N, 2] float32 after backward: gradient with respect to the projected means, px."""
    stats: dict[str, float] | None = None
    """Counts and milliseconds by stage (gs_stats), after forward and again after backward."""


@dataclass(frozen=True)
class RasterOutput:
    """A rendered view, differentiable."""

    rgb: Tensor
    """[H, W, 3], background included."""
    alpha: Tensor
    """[H, W]."""
    inverse_depth: Tensor | None
    """[H, W], sum of weight / z, not divided by alpha; None unless asked for."""
    depth: Tensor | None
    """[H, W], sum of weight * z / sum of weight, 0 where nothing is; None unless asked for."""
    median_depth: Tensor | None
    """[H, W], z at which transmittance falls to 0.5 or less, 0 where it never does; not
    differentiable; None unless asked for."""


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *args: Any) -> tuple[Tensor, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        *tensors, viewmat, settings, aux = args
        s: Settings = settings
        h, w = s.height, s.width
        rgb, alpha = torch.zeros(h, w, 3), torch.zeros(h, w)
        inverse = torch.zeros(h, w) if s.outputs & _native.OUT_INVERSE_DEPTH else torch.zeros(0)
        depth = torch.zeros(h, w) if s.outputs & _native.OUT_DEPTH else torch.zeros(0)
        median = torch.zeros(h, w) if s.outputs & _native.OUT_MEDIAN_DEPTH else torch.zeros(0)
        if aux is not None:
            aux.radii = torch.zeros(tensors[0].shape[0], dtype=torch.int32)
        raster = _native.pool.take()
        try:
            picture = Picture(rgb, alpha, inverse, depth, median)
            forward(raster, tensors, viewmat, s, picture, None if aux is None else aux.radii)
            if aux is not None:
                aux.stats = raster.stats().as_dict()
        except BaseException:
            _native.pool.give_back(raster)
            raise
        if any(ctx.needs_input_grad):
            ctx.save_for_backward(*tensors)
            ctx.raster, ctx.settings, ctx.aux = _Lease(raster), s, aux
        else:
            _native.pool.give_back(raster)
        ctx.set_materialize_grads(False)
        ctx.mark_non_differentiable(median)
        return rgb, alpha, inverse, depth, median

    @staticmethod
    def backward(ctx: Any, *v_outputs: Tensor | None) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        tensors, aux = ctx.saved_tensors, ctx.aux
        kept = [None if v is None else v.to(torch.float32).contiguous() for v in v_outputs[:4]]
        found = {n: torch.empty_like(t) for n, t in zip(PARAMETERS, tensors, strict=True)}
        results = list(found.values())
        v_viewmat = torch.zeros(4, 4) if ctx.needs_input_grad[6] else None
        if aux is not None:
            found["means2d"] = aux.v_means2d = torch.empty(tensors[0].shape[0], 2)
        if v_viewmat is not None:
            found["viewmat"] = v_viewmat
        raster = ctx.raster.raster
        backward(raster, tensors, ctx.settings, kept, found)
        if aux is not None:
            aux.stats = raster.stats().as_dict()
        return (*results, v_viewmat, None, None)


class _Lease:
    """Gives a workspace back when the graph that needs it is gone, run backward or not."""

    def __init__(self, raster: _native.Raster) -> None:
        self.raster = raster

    def __del__(self) -> None:
        _native.pool.give_back(self.raster)


def rasterize(
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
    background: tuple[float, float, float] | Tensor | None = None,
    near: float = 0.01,
    far: float = 1e10,
    eps2d: float = 0.3,
    antialias: bool = False,
    inverse_depth: bool = False,
    depth: bool = False,
    median_depth: bool = False,
    threads: int = 0,
    disable: int = 0,
    cancel: _native.CancelFlag | None = None,
    tiles: Tensor | None = None,
    aux: RasterAux | None = None,
) -> RasterOutput:
    """Render splats from one pinhole camera (Kerbl et al. 2023; EWA of Zwicker et al. 2001).

    Differentiable in means, quats, scales, opacities, sh0, shN and viewmat; not in K, background.

    Args:
        means: [N, 3] world units.
        quats: [N, 4] wxyz, of any length above 1e-8.
        scales: [N, 3] standard deviations in world units; their natural logs where `raw`.
        opacities: [N] in [0, 1]; logits where `raw`.
        sh0: [N, 1, 3] constant SH coefficient.
        shN: [N, K-1, 3] higher coefficients, K-1 = 0, 3, 8 or 15.
        viewmat: [4, 4] world to camera, OpenCV axes.
        K: [3, 3] pixels, without skew; pixel centres lie at +0.5.
        width: Pixels.
        height: Pixels.
        raw: Activate inside (exp, sigmoid), with gradients to the raw values.
        sh_degree: Degree that is evaluated; None: all that is stored.
        background: RGB behind the splats; None: black.
        near: Splats with z at or below this are not drawn; world units.
        far: Splats beyond this are not drawn; world units.
        eps2d: Added to the diagonal of the 2D covariance, px^2.
        antialias: Multiply opacities by max(sqrt(det0 / det), 0.005).
        inverse_depth: Also return the accumulated inverse depth.
        depth: Also return the expected depth.
        median_depth: Also return the median depth.
        threads: 0: all cores. Results do not depend on it.
        disable: Bits of `_native.NO_*`: skips to leave out, for tests and benchmarks.
        cancel: Set it from another thread to stop this call or its backward pass.
        tiles: [ceil(H / 16), ceil(W / 16)] uint8: no splat is drawn in tiles of 16 x 16 px that are
            0 here; None: all are drawn.
        aux: Where radii, screen gradients and statistics go.

    Returns:
        The picture, alpha and the depths asked for.

    Raises:
        ShapeError: A tensor has another shape, dtype or device, or an option is out of range.
        BackendError: The native library is missing or out of memory.
        Cancelled: `cancel` was set.
    """
    tensors = (means, quats, scales, opacities, sh0, shN)
    stored = check_splats(tensors, viewmat)
    _native.check_size(width, height)
    if background is None:
        color = (0.0, 0.0, 0.0)
    else:
        r, g, b = (float(c) for c in background)
        color = (r, g, b)
    tiles = check_tiles(tiles, width, height)
    outputs = (
        _native.OUT_INVERSE_DEPTH * inverse_depth
        | _native.OUT_DEPTH * depth
        | _native.OUT_MEDIAN_DEPTH * median_depth
    )
    settings = Settings(
        raw=raw,
        sh_degree=stored if sh_degree is None else sh_degree,
        width=width,
        height=height,
        K=K.detach().numpy(),
        near=near,
        far=far,
        eps2d=eps2d,
        antialias=antialias,
        background=color,
        outputs=outputs,
        disable=disable,
        threads=threads,
        cancel=cancel,
        tiles=tiles,
    )
    rgb, alpha, inverse, weighted, median = _Rasterize.apply(
        *(t.contiguous() for t in tensors), viewmat.contiguous(), settings, aux
    )  # pyright: ignore[reportGeneralTypeIssues]
    expected = None
    if depth:
        # The quotient's gradient comes from torch; where alpha is 0 so is the sum.
        expected = weighted / torch.where(alpha > 0, alpha, torch.ones_like(alpha))
    return RasterOutput(
        rgb,
        alpha,
        inverse if inverse_depth else None,
        expected,
        median if median_depth else None,
    )
