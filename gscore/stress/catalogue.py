"""Catalogue of stress cases: imports each module with cases, and sorts `case.CASES`."""

from . import (
    antialias,
    cameras,
    chain,
    depth,
    exponential,
    extreme_input,
    files,
    harmonics,
    optimizer,
    order,
    pictures,
    sizes,
    ssim,
    threads,
    training,
)
from .case import CASES

CASES.sort(key=lambda c: c.name)
