"""Random numbers of a training, independent of the default dtype and device of torch."""

import torch


def generator_of(seed: int) -> torch.Generator:
    """Return the random generator of a training."""
    return torch.Generator(device="cpu").manual_seed(seed)


def uniform(
    count: int, generator: torch.Generator, *, dtype: torch.dtype = torch.float32
) -> torch.Tensor:
    """Return [count] uniform random numbers in [0, 1)."""
    return torch.rand(count, generator=generator, dtype=dtype, device="cpu")


def gaussian(shape: tuple[int, ...], generator: torch.Generator) -> torch.Tensor:
    """Return float32 random numbers of mean 0 and standard deviation 1."""
    return torch.randn(shape, generator=generator, dtype=torch.float32, device="cpu")


def permutation(count: int, generator: torch.Generator) -> list[int]:
    """Return 0 to `count` - 1 in random order."""
    return torch.randperm(count, generator=generator, dtype=torch.int64, device="cpu").tolist()
