"""Memory for the library's results: new float32 CPU tensors, independent of torch's defaults."""

import torch
from torch import Tensor


def zeros(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
    """A contiguous tensor of zeros on the CPU."""
    return torch.zeros(shape, dtype=dtype, device="cpu")


def ones(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
    """A contiguous tensor of ones on the CPU."""
    return torch.ones(shape, dtype=dtype, device="cpu")


def empty(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
    """A contiguous, uninitialised tensor on the CPU."""
    return torch.empty(shape, dtype=dtype, device="cpu")
