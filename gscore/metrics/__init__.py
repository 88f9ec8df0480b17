"""Metrics of renders against photos, metrics.json and report.html."""

from .cameras_plan import cameras_section
from .evaluate import Evaluation, evaluate
from .histograms import splat_histograms
from .image import d_ssim, image_metrics, ms_ssim, psnr, psnr_cc, psnr_u8, ssim
from .lpips import Lpips, find_lpips, lpips_warnings
from .lpips_net import LpipsNet
from .machine import peak_memory_bytes
from .pictures import PictureCollector
from .report import Report, write_report
from .results import write_results
from .summary import Course, Metrics, headline, write_metrics

__all__ = [
    "Course",
    "Evaluation",
    "Lpips",
    "LpipsNet",
    "Metrics",
    "PictureCollector",
    "Report",
    "cameras_section",
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
    "splat_histograms",
    "ssim",
    "write_metrics",
    "write_report",
    "write_results",
]
