"""Metrics of renders against photos, and metrics.json."""

from .evaluate import Evaluation, evaluate
from .image import d_ssim, image_metrics, ms_ssim, psnr, psnr_cc, psnr_u8, ssim
from .lpips import Lpips, LpipsNet, find_lpips, lpips_warnings
from .machine import peak_memory_bytes
from .summary import Course, Metrics, headline, write_metrics
