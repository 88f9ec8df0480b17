"""The native rasterizer as a differentiable torch function: one camera per call, float32, CPU."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from ..shared_constants import EPS2D
from ..splats import PARAMETERS
from . import _native, arguments, header
from .buffers import address
from .gpu.header import GRADIENTS
from .memory import empty, zeros
from .no_double_backward import no_double_backward
from .request import CancelFlag, Frustum, Settings

if TYPE_CHECKING:
    from .gpu.gpu_raster import GpuRaster


@dataclass
class RasterAux:
    """Auxiliary outputs for a strategy, filled by the call it is passed to."""

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
    """[H, W], sum of weight / z, not divided by alpha; None unless requested."""
    depth: Tensor | None
    """[H, W], sum of weight * z / sum of weight, 0 where alpha is 0; None unless requested."""
    median_depth: Tensor | None
    """[H, W], z at which transmittance falls to 0.5 or less, 0 where it never does; not
    differentiable; None unless requested."""


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *args: Any) -> tuple[Tensor, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        *splats, _viewmat, view, settings, aux, device = args
        size = (view.height, view.width)
        pictures = {"rgb": zeros(*size, 3), "alpha": zeros(*size)}
        requested = (n for n, bit in header.DEPTH_OUTPUTS.items() if settings.outputs & bit)
        pictures |= {name: zeros(*size) for name in requested}
        radii = {} if aux is None else {"radii": zeros(len(splats[0]), dtype=torch.int32)}
        learns = any(ctx.needs_input_grad)
        if learns and device is not None:
            settings = replace(settings, outputs=settings.outputs | GRADIENTS)
        raster = device or _native.pool.take()
        try:
            raster.forward(splats, view, settings, pictures | radii)
            if aux is not None:
                aux.radii, aux.stats = radii["radii"], raster.stats()
        except BaseException:
            _give_back(raster)
            raise
        if learns:
            ctx.save_for_backward(*splats, _viewmat)
            ctx.raster, ctx.call, ctx.aux = _Lease(raster), (view, settings), aux
        else:
            _give_back(raster)
        ctx.set_materialize_grads(False)
        found = [pictures.get(name, zeros(0)) for name in ("rgb", "alpha", *header.DEPTH_OUTPUTS)]
        ctx.mark_non_differentiable(found[-1])
        return tuple(found)

    @staticmethod
    def backward(ctx: Any, *v_outputs: Tensor | None) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        *splats, viewmat = ctx.saved_tensors
        view, settings = ctx.call
        v_pictures = {
            name: None if v is None else v.detach().to(torch.float32).contiguous()
            for name, v in zip(("rgb", "alpha", "inverse_depth", "depth"), v_outputs, strict=False)
        }
        grads = {name: empty(*t.shape) for name, t in zip(PARAMETERS, splats, strict=True)}
        aux, extra = ctx.aux, {}
        if aux is not None:
            extra["means2d"] = aux.v_means2d = empty(len(splats[0]), 2)
        if ctx.needs_input_grad[len(splats)]:
            extra["viewmat"] = zeros(4, 4)
        raster = ctx.raster.raster
        raster.backward(splats, view, settings, v_pictures, grads | extra)
        if aux is not None:
            aux.stats = raster.stats()
        found = [*grads.values(), extra.get("viewmat")]
        incoming = [v for v in v_outputs if v is not None]
        return (
            *no_double_backward("rasterize", found, [*splats, viewmat, *incoming]),
            None,
            None,
            None,
            None,
        )


def _give_back(raster: "_native.Raster | GpuRaster") -> None:
    """Return a workspace of the CPU to the pool; a device is shared."""
    if isinstance(raster, _native.Raster):
        _native.pool.release(raster)


class _Lease:
    """Returns a workspace to the pool when its graph is deleted, with or without a backward
    pass."""

    def __init__(self, raster: "_native.Raster | GpuRaster") -> None:
        self.raster = raster

    def __del__(self) -> None:
        _give_back(self.raster)


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
    eps2d: float = EPS2D,
    antialias: bool = False,
    inverse_depth: bool = False,
    depth: bool = False,
    median_depth: bool = False,
    threads: int = 0,
    disable: int = 0,
    cancel: CancelFlag | None = None,
    tiles: Tensor | None = None,
    far_depths: Tensor | None = None,
    aux: RasterAux | None = None,
    device: "GpuRaster | None" = None,
) -> RasterOutput:
    """Render splats from one pinhole camera (Kerbl et al. 2023; EWA of Zwicker et al. 2001).

    Differentiable once in means, quats, scales, opacities, sh0, shN and viewmat; not in K and
    background. A second derivative raises GsError.

    Args:
        means: [N, 3] world units.
        quats: [N, 4] wxyz, of any length; without a component of 1e-8 the splat is not drawn.
        scales: [N, 3] standard deviations in world units; their natural logs where `raw`.
        opacities: [N] in [0, 1]; logits where `raw`.
        sh0: [N, 1, 3] constant SH coefficient.
        shN: [N, K-1, 3] higher coefficients, K-1 = 0, 3, 8, 15 or 24.
        viewmat: [4, 4] world to camera, OpenCV axes.
        K: [3, 3] px, without skew; pixel centres are at +0.5.
        width: Of the picture, px.
        height: Of the picture, px.
        raw: Activate inside (exp, sigmoid), with gradients in the raw values.
        sh_degree: Degree to evaluate; None: the stored degree.
        background: RGB background colour; None: black.
        near: Splats with z at or below this are not drawn; world units.
        far: Splats beyond this are not drawn; world units.
        eps2d: Added to the diagonal of the 2D covariance, px^2.
        antialias: Multiply opacities by max(sqrt(det0 / det), 0.005).
        inverse_depth: Also return the accumulated inverse depth.
        depth: Also return the expected depth.
        median_depth: Also return the median depth.
        threads: 0: all cores. Results do not depend on it.
        disable: Bits of `header.NO_*`: skips to disable, for tests and benchmarks.
        cancel: Set it from another thread to stop this call or its backward pass.
        tiles: [ceil(H / 16), ceil(W / 16)] uint8: no splat is drawn in tiles of 16 x 16 px that are
            0 here; None: all are drawn.
        far_depths: [H, W] float32: at a pixel only splats with z at most this are drawn, in front
            of an opaque object; world units. None, or NaN at a pixel: all.
        aux: Receives radii, screen-space gradients and statistics.
        device: An open device that draws; None: the CPU.

    Returns:
        The picture, alpha and the requested depths.

    Raises:
        ShapeError: A tensor has a wrong shape, dtype or device, or an option is out of range.
        BackendError: The native library is missing or out of memory.
        Cancelled: `cancel` was set.
    """
    splats = [t.contiguous() for t in (means, quats, scales, opacities, sh0, shN)]
    viewmat = viewmat.contiguous()
    address("viewmat", viewmat, (4, 4))
    arguments.check_size(width, height)
    requested = {"inverse_depth": inverse_depth, "depth": depth, "median_depth": median_depth}
    if background is None:
        color = (0.0, 0.0, 0.0)
    else:
        r, g, b = (float(c) for c in background)
        color = (r, g, b)
    view = Frustum(viewmat.detach(), K.detach(), width, height, near, far)
    settings = Settings(
        raw=raw,
        sh_degree=sh_degree,
        eps2d=eps2d,
        antialias=antialias,
        background=color,
        outputs=sum(bit for name, bit in header.DEPTH_OUTPUTS.items() if requested[name]),
        tiles=None if tiles is None else tiles.contiguous(),
        far_depths=None if far_depths is None else far_depths.detach().contiguous(),
        threads=threads,
        disable=disable,
        cancel=cancel,
    )
    rgb, alpha, inverse, weighted, median = _Rasterize.apply(  # pyright: ignore[reportGeneralTypeIssues]
        *splats, viewmat, view, settings, aux, device
    )
    expected = None
    if depth:
        # torch differentiates the quotient; where alpha is 0 so is the sum.
        expected = weighted / torch.where(alpha > 0, alpha, torch.ones_like(alpha))
    return RasterOutput(
        rgb,
        alpha,
        inverse if inverse_depth else None,
        expected,
        median if median_depth else None,
    )
