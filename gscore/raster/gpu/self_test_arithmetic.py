"""Arithmetic of a device in its self-test: exponentials, rounding errors, sorting."""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain
from typing import Any

import numpy as np

from . import header
from .gpu_raster import GpuRaster

_Result = tuple[list[str], dict[str, Any]]
_EXP2_ERROR = 2.5e-7
"""Largest relative error of 2^x, see docs/accuracy.md."""
_TINY = 2.0**-25
"""Below this magnitude 2^-x is 1 in float32."""
_CHUNK = 1 << 20
_NATIVE_EVERY = 16
"""One chunk in this many measures the device's own exp2."""
_PAIRS = 1_000_000
_SORTED = (1, 4095, 4097, 100_003)
"""Numbers of sorted keys, around the seams of the blocks of the sort."""


def arithmetic_checks() -> Iterator[tuple[str, Callable[[GpuRaster], _Result]]]:
    """Name and function of each test."""
    yield "sorting", sorting
    yield "rounding errors of products", partial(_rounding, header.TEST_PRODUCT, _product_error)
    yield "rounding errors of sums", partial(_rounding, header.TEST_SUM, _sum_error)
    yield "fused multiply-add", fused
    yield "exponentials", exponentials


def exponentials(raster: GpuRaster, step: int = 1) -> _Result:
    """Oracle: exp2 in float64, for every float32 in [-8, -2^-25] and some nearer to zero.

    The device's own exp2 is measured on a part of them, because the pictures do not use it.

    Args:
        raster: The device.
        step: Test one float in this many.
    """
    first = int(np.float32(-_TINY).view(np.uint32))
    last = int(np.float32(-8.0).view(np.uint32))
    near_zero = np.arange(0x80000000, first, 12347, dtype=np.int64)
    error = native_error = 0.0
    starts = range(first, last + 1, _CHUNK * step)
    parts = (np.arange(s, min(s + _CHUNK * step, last + 1), step, dtype=np.int64) for s in starts)
    for i, bits in enumerate(chain([near_zero], parts)):
        x = bits.astype(np.uint32).view(np.float32)
        true = np.exp2(x.astype(np.float64))
        error = np.maximum(error, _largest_error(raster, header.TEST_EXP2, x, true))
        if i % _NATIVE_EVERY == 0:
            native = _largest_error(raster, header.TEST_NATIVE_EXP2, x, true)
            native_error = np.maximum(native_error, native)
    problems = [] if error <= _EXP2_ERROR else [f"a relative error of {error:.1e}"]
    return problems, {"exp2_error": float(error), "native_exp2_error": float(native_error)}


def _largest_error(raster: GpuRaster, kernel: int, x: np.ndarray, true: np.ndarray) -> float:
    """Largest relative error of a kernel; NaN if one of its values is."""
    found = raster.test(kernel, x).view(np.float32) / true
    found -= 1
    return np.maximum(found.max(), -found.min())


def _random_pairs(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Floats of both signs between 2^-12 and 2^12: their products and sums are exact in float64,
    and rounding errors far from subnormal."""
    rng = np.random.default_rng(seed)
    values = rng.uniform(1, 2, (2, _PAIRS)) * np.exp2(rng.integers(-12, 12, (2, _PAIRS)))
    a, b = (values * rng.choice([-1.0, 1.0], (2, _PAIRS))).astype(np.float32)
    return a, b


def _product_error(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    exact = a.astype(np.float64) * b
    return (exact - exact.astype(np.float32)).astype(np.float32)


def _sum_error(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    exact = a.astype(np.float64) + b
    return (exact - exact.astype(np.float32)).astype(np.float32)


def _rounding(
    kernel: int, oracle: Callable[[np.ndarray, np.ndarray], np.ndarray], raster: GpuRaster
) -> _Result:
    """Oracle: float64, in which products and sums of two such floats are exact."""
    a, b = _random_pairs(kernel)
    different = int((raster.test(kernel, a, b).view(np.float32) != oracle(a, b)).sum())
    return [f"{different} of {_PAIRS} differ"] if different else [], {}


def fused(raster: GpuRaster) -> _Result:
    """Whether fma() rounds once; nothing depends on it, so that it is only stated."""
    a, b = _random_pairs(header.TEST_FMA)
    found = raster.test(header.TEST_FMA, a, b).view(np.float32)
    return [], {"fma_rounds_once": bool((found == _product_error(a, b)).all())}


def sorting(raster: GpuRaster) -> _Result:
    """Oracle: numpy's stable sort, of keys with many ties and of keys of all bits."""
    problems = []
    for count in _SORTED:
        rng = np.random.default_rng(count)
        keys = rng.integers(0, 1 << 32, count, dtype=np.uint32)
        for one in (keys, keys & np.uint32(0x00070001)):
            rows = raster.test(header.TEST_SORT, one)
            different = int((rows != np.argsort(one, kind="stable")).sum())
            if different:
                problems.append(f"{different} of {count} keys are in the wrong place")
    return problems, {}
