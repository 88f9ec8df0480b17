"""The fused L1 + SSIM loss of the native library as a differentiable torch function."""

import ctypes as ct
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..errors import ShapeError
from . import _native


@dataclass(frozen=True)
class ImageLoss:
    """The loss, and what it is made of."""

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


class _Loss(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, image: Tensor, args: Any, parts: Any) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        v_image = torch.empty_like(image) if ctx.needs_input_grad[0] else None
        with _native.pool.lend() as raster:
            result = raster.image_loss(args, v_image.data_ptr() if v_image is not None else None)
        parts.append(result)
        ctx.v_image = v_image
        return torch.tensor(result.loss, dtype=torch.float32)

    @staticmethod
    def backward(ctx: Any, v_loss: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        v = ctx.v_image
        # The usual gradient of a loss that is minimised as it is; saves a pass over the image.
        return v if v_loss.item() == 1.0 else v * v_loss, None, None


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
    """(1 - w) L1 + w (1 - SSIM), differentiable in `image` (Kerbl et al. 2023, eq. 7).

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
        ShapeError: A tensor has another shape or dtype, or the mode does not exist.
    """
    args, kept = _arguments(image, target, ssim_weight, mask, mask_mode, background, threads)
    parts: list[_native.LossResultStruct] = []
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
) -> LossValues:
    """`image_loss` and its gradient at once, without autograd.

    `v_image` [H, W, 3] float32, contiguous, is overwritten with the gradient in `image`; the other
    arguments and errors are those of `image_loss`.
    """
    args, _kept = _arguments(image, target, ssim_weight, mask, mask_mode, background, threads)
    if (
        v_image.shape != image.shape
        or v_image.dtype != torch.float32
        or not v_image.is_contiguous()
    ):
        raise ShapeError(
            f"v_image must be {list(image.shape)} float32, contiguous, "
            f"got {list(v_image.shape)} {v_image.dtype}."
        )
    with _native.pool.lend() as raster:
        found = raster.image_loss(args, v_image.data_ptr())
    return LossValues(found.loss, found.l1, found.ssim, found.mse)


def _arguments(
    image: Tensor,
    target: Tensor,
    ssim_weight: float,
    mask: Tensor | None,
    mask_mode: str,
    background: tuple[float, float, float],
    threads: int,
) -> tuple[_native.LossArgsStruct, list[Tensor]]:
    """Checked arguments, and the tensors whose memory they point at, the image first."""
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != torch.float32:
        raise ShapeError(f"image must be [H, W, 3] float32, got {list(image.shape)} {image.dtype}.")
    if target.shape != image.shape or target.dtype != torch.uint8:
        raise ShapeError(
            f"target must be {list(image.shape)} uint8, got {list(target.shape)} {target.dtype}."
        )
    if mask_mode not in _native.MASK_MODES:
        raise ShapeError(f"mask_mode must be one of {list(_native.MASK_MODES)}, got {mask_mode!r}.")
    if mask_mode != "none" and (
        mask is None or mask.shape != image.shape[:2] or mask.dtype != torch.uint8
    ):
        got = "none" if mask is None else f"{list(mask.shape)} {mask.dtype}"
        raise ShapeError(f"mask must be {list(image.shape[:2])} uint8, got {got}.")
    image, target = image.contiguous(), target.contiguous()
    mask = mask.contiguous() if mask is not None else None
    height, width = image.shape[:2]
    args = _native.LossArgsStruct(
        width=width,
        height=height,
        image=image.data_ptr(),
        target=target.data_ptr(),
        mask=mask.data_ptr() if mask is not None else None,
        mask_mode=_native.MASK_MODES[mask_mode],
        ssim_weight=ssim_weight,
        threads=threads,
    )
    args.background = (ct.c_float * 3)(*background)
    return args, [image, target] if mask is None else [image, target, mask]
