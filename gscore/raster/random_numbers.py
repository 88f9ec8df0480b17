"""Random numbers of a training step, keyed by seed, step and row, natively on torch tensors.

The same keys give the same numbers on any number of threads and on any engine; `reference` has the
definition. A stream is a number: different streams of a step are independent.
"""

import torch

from . import _native
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
    _native.random_numbers(out, seed=seed, step=step, stream=stream, rows=None, threads=threads)
    return out


def normal_rows(
    rows: torch.Tensor, *, seed: int, step: int, stream: int, threads: int = 0
) -> torch.Tensor:
    """Return [M, 3] float32 of mean 0 and variance 1 for these rows, [M] int64; the other arguments
    are those of `uniform_rows`."""
    out = empty(len(rows), 3)
    _native.random_numbers(out, seed=seed, step=step, stream=stream, rows=rows, threads=threads)
    return out
