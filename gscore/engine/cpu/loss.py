"""Step loss: the photometric loss of a view with its opacity terms, and their gradients."""

from typing import NamedTuple

import numpy as np
import torch

from ...photo_exposure import PhotoExposure
from ...raster.blur import blur_image
from ...raster.loss import LossValues, image_loss_gradient
from ...raster.memory import empty
from ...raster.training_rasterizer import Picture
from ..base import Color, StepPhoto, StepRequest, TermKind


class LossAndGradients(NamedTuple):
    """Loss of a view, and its gradients in the rendered image."""

    value: float
    """Total loss."""
    mse: float
    """Mean squared error of the unmasked pixels."""
    v_rgb: torch.Tensor
    """[H, W, 3] float32; valid until the next call."""
    v_log_gain: tuple[float, float, float]
    """Derivatives in ln gain of R, G, B."""
    v_alpha: torch.Tensor | None
    """[H, W] float32; None: the loss does not depend on it."""
    v_inverse_depth: torch.Tensor | None
    """[H, W] float32; None: the loss does not depend on it."""


class StepLoss:
    """Loss of rendered views, with memory reused from call to call."""

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._v_rgb = empty(0)

    def photometric(
        self,
        rgb: torch.Tensor,
        photo: StepPhoto,
        *,
        background: Color,
        ssim_weight: float = 0.2,
        gain: torch.Tensor | None = None,
    ) -> tuple[LossValues, torch.Tensor]:
        """Compute L1 and SSIM of an image, [H, W, 3], against its photo, and their gradient in the
        image, which is valid until the next call."""
        if self._v_rgb.shape != rgb.shape:
            self._v_rgb = empty(*rgb.shape)
        found = image_loss_gradient(
            rgb,
            torch.from_numpy(photo.image),
            self._v_rgb,
            ssim_weight=ssim_weight,
            mask=None if photo.mask is None else torch.from_numpy(photo.mask),
            mask_mode="none" if photo.mask is None else photo.mask_mode,
            background=background,
            threads=self._threads,
            gain=gain,
        )
        return found, self._v_rgb

    def of(self, picture: Picture, photo: StepPhoto, request: StepRequest) -> LossAndGradients:
        """Compute the loss of a rendered view."""
        gain = (
            None
            if request.gain is None
            else torch.tensor(request.gain, dtype=torch.float32, device="cpu")
        )
        rgb = picture.rgb
        if request.blur is not None:
            rgb = blur_image(rgb, request.blur, threads=self._threads)
        found, v_rgb = self.photometric(
            rgb,
            photo,
            background=request.shown_background,
            ssim_weight=dict(request.terms)[TermKind.SSIM],
            gain=gain,
        )
        if request.blur is not None:
            v_rgb = blur_image(v_rgb, request.blur, adjoint=True, threads=self._threads)
        more, v_alpha, v_inverse_depth = _further_terms(picture, photo, request)
        v_log_gain = found.v_log_gain
        if request.gain is not None and photo.mask_mode == "composite":
            v_log_gain = without_background(
                v_log_gain, request.shown_background, request.gain, v_rgb, picture.alpha
            )
        return LossAndGradients(
            value=found.loss + more,
            mse=mse_of_unmasked(found.mse, photo.counted),
            v_rgb=v_rgb,
            v_log_gain=v_log_gain,
            v_alpha=v_alpha,
            v_inverse_depth=v_inverse_depth,
        )


def without_background(
    v_log_gain: Color,
    background: Color,
    gain: Color,
    v_rgb: torch.Tensor,
    alpha: torch.Tensor,
) -> Color:
    """Return the derivative in ln gain if the background before the gain follows it, so that the
    visible background is constant.

    Args:
        v_log_gain: Derivative for a constant background before the gain.
        background: Visible background colour.
        gain: Gain of R, G, B.
        v_rgb: [H, W, 3] gradient in the rendered image before the gain.
        alpha: [H, W] rendered opacity.
    """
    if not any(background):  # black stays black
        return v_log_gain
    through = torch.mv(v_rgb.reshape(-1, 3).t(), (1 - alpha).flatten()).tolist()
    slopes = PhotoExposure.of(gain).behind_by_log_gain(background).tolist()
    r, g, b = (w + t * s for w, t, s in zip(v_log_gain, through, slopes, strict=True))
    return (r, g, b)


def mse_of_unmasked(mse: float, counted: float) -> float:
    """Mean squared error of the unmasked pixels, a share `counted` of all, if the others have no
    error; 0 without any."""
    return mse / counted if counted > 0 else 0.0


def _further_terms(
    picture: Picture, photo: StepPhoto, request: StepRequest
) -> tuple[float, torch.Tensor | None, torch.Tensor | None]:
    """Compute the terms besides the photometric ones, with their gradients in opacity and inverse
    depth; None: no dependence."""
    value, v_alpha, v_inverse_depth = 0.0, None, None
    weights = dict(request.terms)
    if request.picture_term is not None and picture.inverse_depth is not None:
        found = request.picture_term(picture.inverse_depth.numpy(), picture.alpha.numpy())
        value += found.value
        v_inverse_depth, v_alpha = (
            None if v is None else torch.from_numpy(v)
            for v in (found.v_inverse_depth, found.v_alpha)
        )
    weight = weights.get(TermKind.MASK_ALPHA, 0.0)
    if weight and photo.mask is not None:
        alpha = picture.alpha.detach().requires_grad_()
        term = weight * opacity_loss(alpha, torch.from_numpy(photo.mask))
        value += term.item()
        (more,) = torch.autograd.grad(term, alpha)
        v_alpha = more if v_alpha is None else v_alpha + more
    weight = weights.get(TermKind.SEE_THROUGH, 0.0)
    if weight:
        through, slope = mean_transmittance(picture.alpha.detach(), photo.mask)
        value += weight * through
        slope *= weight
        v_alpha = slope if v_alpha is None else v_alpha + slope
    return value, v_alpha, v_inverse_depth


def opacity_loss(alpha: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Mean absolute difference of rendered opacity and mask.

    Args:
        alpha: [H, W] float; differentiable.
        mask: [H, W] uint8, 255 = opaque.
    """
    return (alpha - mask.to(alpha.dtype) * (1 / 255)).abs().mean()


def mean_transmittance(alpha: torch.Tensor, mask: np.ndarray | None) -> tuple[float, torch.Tensor]:
    """Mean transmittance of a view, and its gradient in `alpha`: a loss for opaque scenes.

    Over a black background black pixels need no splat, and 1 to 7 % of the light of whole captures
    passes between the splats (docs/experiments).

    Args:
        alpha: [H, W] float, rendered opacity.
        mask: [H, W] uint8, weight of each pixel, 255 = 1; None: 1 everywhere.

    Returns:
        The mean of (1 - alpha) mask / 255 over all pixels, and [H, W] of alpha's dtype.
    """
    if mask is None:
        slope = torch.full_like(alpha, -1 / alpha.numel())
    else:
        slope = torch.from_numpy(mask).to(alpha.dtype) * (-1 / (255 * alpha.numel()))
    return float(((alpha - 1) * slope).sum()), slope
