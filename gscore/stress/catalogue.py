"""Catalogue of stress cases: imports each module with cases, and sorts `case.CASES`."""

from . import (
    antialias,
    cameras,
    chain,
    depth,
    exponential,
    files,
    harmonics,
    optimizer,
    order,
    pictures,
    poison,
    sizes,
    ssim,
    threads,
    training,
)
from .case import CASES

__all__ = [
    "CASES",
    "antialias",
    "cameras",
    "chain",
    "depth",
    "exponential",
    "files",
    "harmonics",
    "optimizer",
    "order",
    "pictures",
    "poison",
    "sizes",
    "ssim",
    "threads",
    "training",
]

CASES.sort(key=lambda c: c.name)
