"""Reference image loss: (1 - w) L1 + w (1 - SSIM), with masks, differentiable by autograd.

Sources: Kerbl et al. 2023, equation 7; Wang et al. 2004, equation 13.
"""

import torch
from torch import Tensor
from torch.nn import functional

from ...shared_constants import (
    EXPOSURE_OFFSET,
    EXPOSURE_POWER,
    SSIM_C1,
    SSIM_C2,
    SSIM_SIGMA,
    SSIM_WINDOW,
)


def image_loss_reference(
    image: Tensor,
    target: Tensor,
    *,
    ssim_weight: float = 0.2,
    mask: Tensor | None = None,
    mask_mode: str = "none",
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    gain: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Loss and SSIM of a picture, in the picture's dtype.

    Args:
        image: [H, W, 3] float64.
        target: [H, W, 3] uint8, the photo.
        ssim_weight: w.
        mask: [H, W] uint8.
        mask_mode: "none", "composite" (target = photo * mask + background * (1 - mask)) or
            "ignore" (image and photo are both multiplied by the mask).
        background: RGB used by "composite".
        gain: [3] float64: exposure of the image (`gscore.photo_exposure`), which is clamped to
            white where the target is white.

    Returns:
        The scalar loss and the mean SSIM, zero padded.
    """
    if gain is not None:
        image = exposed_reference(image, gain)
    y = target.to(image.dtype) / 255
    m = None if mask is None or mask_mode == "none" else mask.to(image.dtype)[..., None] / 255
    if m is not None and mask_mode == "composite":
        y = y * m + torch.tensor(background, dtype=image.dtype) * (1 - m)
    elif m is not None:
        image, y = image * m, y * m
    if gain is not None:
        image = torch.where((y >= 1) & (image > 1), torch.ones_like(image), image)
    taps = torch.arange(SSIM_WINDOW, dtype=image.dtype) - SSIM_WINDOW // 2
    taps = torch.exp(-(taps**2) / (2 * SSIM_SIGMA**2))
    taps = taps / taps.sum()
    window = torch.outer(taps, taps)[None, None]

    def blur(x: Tensor) -> Tensor:
        return functional.conv2d(x.permute(2, 0, 1)[:, None], window, padding=SSIM_WINDOW // 2)

    mx, my = blur(image), blur(y)
    sx, sy = blur(image * image) - mx * mx, blur(y * y) - my * my
    sxy = blur(image * y) - mx * my
    ssim = ((2 * mx * my + SSIM_C1) * (2 * sxy + SSIM_C2)) / (
        (mx * mx + my * my + SSIM_C1) * (sx + sy + SSIM_C2)
    )
    l1 = (image - y).abs().mean()
    return (1 - ssim_weight) * l1 + ssim_weight * (1 - ssim.mean()), ssim.mean()


def exposed_reference(image: Tensor, gain: Tensor) -> Tensor:
    """Exposure of a picture [..., 3] by a gain [3], differentiable in both (`photo_exposure`)."""
    bright = (image + EXPOSURE_OFFSET) * gain - EXPOSURE_OFFSET
    return torch.where(image < _darkness(gain), image * gain**EXPOSURE_POWER, bright)


def unexposed_reference(image: Tensor, gain: Tensor) -> Tensor:
    """Inverse of `exposed_reference`."""
    steep, bright = gain**EXPOSURE_POWER, (image + EXPOSURE_OFFSET) / gain - EXPOSURE_OFFSET
    return torch.where(image < _darkness(gain) * steep, image / steep, bright)


def _darkness(gain: Tensor) -> Tensor:
    """Value [3] where both lines meet, a constant; its limit for a gain of 1."""
    gain = gain.detach()
    meeting = EXPOSURE_OFFSET * (gain - 1) / (gain**EXPOSURE_POWER - gain)
    return torch.where(gain == 1, EXPOSURE_OFFSET / (EXPOSURE_POWER - 1), meeting)
