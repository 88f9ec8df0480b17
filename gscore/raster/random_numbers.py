"""Random numbers of a training step, keyed by seed, step and row, natively on torch tensors.

The same keys give the same numbers on any number of threads and on any engine; `reference` has the
definition. A stream is a number: different streams of a step are independent.
"""

import ctypes as ct

import torch

from . import _native, arguments, header
from .buffers import INT64, address
from .memory import empty


def uniform_rows(
    count: int, *, seed: int, step: int, stream: int, threads: int = 0
) -> torch.Tensor:
    """Return [count] float32 in [0, 1), one number for each row.

    Args:
        count: Number of rows.
        seed: 0 to 2^64 - 1.
        step: 0 to 2^32 - 1.
        stream: 0 to 2^32 - 1.
        threads: 0: all cores.
    """
    out = empty(count)
    key = header.RandomStruct(seed, step, stream, None, count, arguments.library_threads(threads))
    draw = _native.library().gs_random_uniform
    _native.raise_status(draw(ct.byref(key), address("out", out, (count,))))
    return out


def normal_rows(
    rows: torch.Tensor, *, seed: int, step: int, stream: int, threads: int = 0
) -> torch.Tensor:
    """Return [M, 3] float32 of mean 0 and variance 1 for these rows, [M] int64; the other arguments
    are those of `uniform_rows`."""
    count, out = len(rows), empty(len(rows), 3)
    at, threads = address("rows", rows, (count,), INT64), arguments.library_threads(threads)
    key = header.RandomStruct(seed, step, stream, at, count, threads)
    draw = _native.library().gs_random_normal
    _native.raise_status(draw(ct.byref(key), address("out", out, (count, 3))))
    return out
