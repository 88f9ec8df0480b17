"""The fused L1 + SSIM loss of the native library as a differentiable torch function."""

import ctypes as ct
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..errors import ShapeError
from . import _native, arguments, header
from .buffers import UINT8, address, optional
from .no_double_backward import no_double_backward


@dataclass(frozen=True)
class ImageLoss:
    """The loss and its terms."""

    loss: Tensor
    """Scalar float32, differentiable in the image."""
    l1: float
    ssim: float
    mse: float


@dataclass(frozen=True)
class LossValues:
    """The loss without a graph."""

    loss: float
    l1: float
    ssim: float
    mse: float
    v_log_gain: tuple[float, float, float]
    """Derivative of the loss in the logarithm of the gain; zeros without a gain."""


class _Loss(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, image: Tensor, args: Any, parts: Any) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        v_image = torch.empty_like(image) if ctx.needs_input_grad[0] else None
        with _native.pool.lend() as raster:
            result = raster.image_loss(args, v_image)
        parts.append(result)
        ctx.v_image = v_image
        ctx.save_for_backward(image)
        return torch.tensor(result.loss, dtype=torch.float32, device="cpu")

    @staticmethod
    def backward(ctx: Any, v_loss: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        v = ctx.v_image
        # 1 is the gradient of an unscaled loss; saves a pass over the image.
        v = v if v_loss.item() == 1.0 else v * v_loss
        return *no_double_backward("image_loss", [v], [*ctx.saved_tensors, v_loss]), None, None


def image_loss(
    image: Tensor,
    target: Tensor,
    *,
    ssim_weight: float = 0.2,
    mask: Tensor | None = None,
    mask_mode: str = "none",
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    threads: int = 0,
) -> ImageLoss:
    """(1 - w) L1 + w (1 - SSIM), differentiable once in `image` (Kerbl et al. 2023, eq. 7).

    SSIM (Wang et al. 2004) uses a Gaussian window of 11 px and sigma 1.5 with zero padding, per
    channel, C1 = 0.01^2, C2 = 0.03^2.

    Args:
        image: [H, W, 3] float32, rendered.
        target: [H, W, 3] uint8, the photo.
        ssim_weight: w.
        mask: [H, W] uint8, needed unless `mask_mode` is "none".
        mask_mode: "none"; "composite": target = photo * mask + background * (1 - mask);
            "ignore": image and photo are both multiplied by the mask.
        background: RGB used by "composite".
        threads: 0: all cores.

    Returns:
        The loss and its parts; `mse` is over image and target as they enter the loss.

    Raises:
        ShapeError: A tensor has a wrong shape or dtype, or the mode does not exist.
    """
    args, kept = _arguments(image, target, ssim_weight, mask, mask_mode, background, threads)
    parts: list[ct.Structure] = []
    loss = _Loss.apply(kept[0], args, parts)
    return ImageLoss(loss, parts[0].l1, parts[0].ssim, parts[0].mse)  # pyright: ignore[reportArgumentType]


def image_loss_gradient(
    image: Tensor,
    target: Tensor,
    v_image: Tensor,
    *,
    ssim_weight: float = 0.2,
    mask: Tensor | None = None,
    mask_mode: str = "none",
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    threads: int = 0,
    gain: Tensor | None = None,
) -> LossValues:
    """`image_loss` and its gradient in one call, without autograd.

    `v_image` [H, W, 3] float32, contiguous, is overwritten with the gradient in `image`. With
    `gain` [3] float32, above 0, the loss is that of the exposed image (`gscore.photo_exposure`);
    where the photo is white and this image brighter, it counts as white and receives no gradient.
    The other arguments and errors are those of `image_loss`.
    """
    args, _kept = _arguments(image, target, ssim_weight, mask, mask_mode, background, threads, gain)
    with _native.pool.lend() as raster:
        found = raster.image_loss(args, v_image)
    r, g, b = found.v_log_gain
    return LossValues(found.loss, found.l1, found.ssim, found.mse, (r, g, b))


def _arguments(
    image: Tensor,
    target: Tensor,
    ssim_weight: float,
    mask: Tensor | None,
    mask_mode: str,
    background: tuple[float, float, float],
    threads: int,
    gain: Tensor | None = None,
) -> tuple[ct.Structure, list[Tensor]]:
    """gs_loss_args, and the tensors they point to, the image first."""
    shape = tuple(image.shape)
    if len(shape) != 3 or shape[2] != 3:
        raise ShapeError(f"image must be [H, W, 3] float32, got {list(shape)} {image.dtype}.")
    if mask_mode not in header.MASK_MODES:
        known = list(header.MASK_MODES)
        raise ShapeError(f"mask_mode must be one of {known}, got {mask_mode!r}.")
    height, width = shape[:2]
    arguments.check_size(width, height)
    image, target = image.contiguous(), target.contiguous()
    mask = mask.contiguous() if mask is not None else None
    gain = gain.contiguous() if gain is not None else None
    args = header.LossArgsStruct(
        width=width,
        height=height,
        image=address("image", image, shape),
        target=address("target", target, shape, UINT8),
        mask_mode=header.MASK_MODES[mask_mode],
        background=(ct.c_float * 3)(*background),
        ssim_weight=ssim_weight,
        threads=arguments.library_threads(threads),
        gain=optional("gain", gain, (3,)),
    )
    if mask_mode != "none":
        args.mask = address("mask", mask, (height, width), UINT8)
    return args, [image, *(t for t in (target, mask, gain) if t is not None)]
