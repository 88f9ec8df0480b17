"""Catalogue of stress cases: imports each module with cases, and sorts `case.CASES`."""

from . import (
    cameras,
    chain,
    depth,
    exponential,
    extreme_input,
    files,
    optimizer,
    pictures,
    sizes,
    ssim,
    threads,
    training,
)
from .case import CASES

CASES.sort(key=lambda c: c.name)
