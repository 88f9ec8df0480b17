"""Metrics of renders against photos, metrics.json and report.html."""

from .evaluate import evaluate
from .image import d_ssim, image_metrics, ms_ssim, psnr, psnr_cc, psnr_u8, ssim
from .lpips import Lpips, find_lpips, lpips_warnings
from .machine import peak_memory_bytes
from .pictures import PictureCollector
from .report import write_report
from .summary import headline, summarize, write_metrics

__all__ = [
    "Lpips",
    "PictureCollector",
    "d_ssim",
    "evaluate",
    "find_lpips",
    "headline",
    "image_metrics",
    "lpips_warnings",
    "ms_ssim",
    "peak_memory_bytes",
    "psnr",
    "psnr_cc",
    "psnr_u8",
    "ssim",
    "summarize",
    "write_metrics",
    "write_report",
]
