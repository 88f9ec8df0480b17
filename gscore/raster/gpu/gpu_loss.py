"""Loss of a picture on a device, with copies of all arrays: the kernels of a training step."""

import ctypes as ct
from dataclasses import dataclass

import numpy as np

from ...errors import ShapeError
from .. import arguments
from ..buffers import UINT8, address, optional
from ..header import MASK_MODES, LossArgsStruct
from . import header
from .gpu_raster import GpuRaster

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class GpuLossValues:
    """A loss, its terms and its gradients, as gs_gpu_loss_result has them."""

    sane: bool
    infinite: bool
    loss: float
    l1: float
    ssim: float
    mse: float
    mask_alpha: float
    see_through: float
    v_log_gain: Triple
    v_image: np.ndarray
    """[H, W, 3] float32."""
    v_alpha: np.ndarray
    """[H, W] float32."""


def gpu_image_loss(
    raster: GpuRaster,
    image: np.ndarray,
    target: np.ndarray,
    *,
    ssim_weight: float = 0.2,
    mask: np.ndarray | None = None,
    mask_mode: str = "none",
    background: Triple = (0.0, 0.0, 0.0),
    gain: Triple | None = None,
    blur: Triple | None = None,
    fixed_background: bool = False,
    alpha: np.ndarray | None = None,
    mask_alpha: float = 0.0,
    see_through: float = 0.0,
    counted: float = 1.0,
    rows_at_once: int = 0,
) -> GpuLossValues:
    """gs_gpu_loss.

    Args:
        raster: An open device.
        image: [H, W, 3] float32, rendered.
        target: [H, W, 3] uint8, the photo.
        ssim_weight: Weight of 1 - SSIM; that of L1 is 1 minus it.
        mask: [H, W] uint8.
        mask_mode: "none", "composite" or "ignore".
        background: RGB of a "composite" mask.
        gain: Exposure of the image by channel (`gscore.photo_exposure`), above 0.
        blur: Covariance xx, xy, yy, px^2, by which the image is blurred before the gain.
        fixed_background: The derivative in ln gain takes the visible background as constant.
        alpha: [H, W] float32, rendered opacity.
        mask_alpha: Weight of the mean difference of opacity and mask.
        see_through: Weight of the mean transmittance, weighted by the mask.
        counted: Share of unmasked pixels.
        rows_at_once: Rows of tiles in a submission; 0: all.

    Raises:
        ShapeError: an array or value is invalid.
        BackendError: the device fails, see `GpuRaster.forward`.
    """
    height, width = image.shape[:2]
    arguments.check_size(width, height)
    if mask_mode not in MASK_MODES:
        raise ShapeError(f"mask_mode must be one of {list(MASK_MODES)}, got {mask_mode!r}.")
    factors = None if gain is None else np.array(gain, np.float32)
    args = LossArgsStruct(
        width=width,
        height=height,
        image=address("image", image, (height, width, 3)),
        target=address("target", target, (height, width, 3), UINT8),
        mask=optional("mask", mask, (height, width), UINT8),
        mask_mode=MASK_MODES[mask_mode],
        background=(ct.c_float * 3)(*background),
        ssim_weight=ssim_weight,
        gain=optional("gain", factors, (3,)),
    )
    terms = header.GpuLossTermsStruct(
        alpha=optional("alpha", alpha, (height, width)),
        mask_alpha=mask_alpha,
        see_through=see_through,
        counted=counted,
        fixed_background=fixed_background,
        rows_at_once=rows_at_once,
        has_blur=blur is not None,
        blur=(ct.c_float * 3)(*(blur or (0.0, 0.0, 0.0))),
    )
    v_image = np.empty((height, width, 3), np.float32)
    v_alpha = np.empty((height, width), np.float32)
    found = raster.loss(args, terms, v_image.ctypes.data, v_alpha.ctypes.data)
    r, g, b = found.v_log_gain
    return GpuLossValues(
        sane=bool(found.sane),
        infinite=bool(found.infinite),
        loss=found.loss,
        l1=found.l1,
        ssim=found.ssim,
        mse=found.mse,
        mask_alpha=found.mask_alpha,
        see_through=found.see_through,
        v_log_gain=(r, g, b),
        v_image=v_image,
        v_alpha=v_alpha,
    )
