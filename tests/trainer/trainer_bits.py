"""Bits of a trainer, for comparisons of trainings."""

from typing import Any

from gscore.trainer.trainer import Trainer


def tensor_bits(trainer: Trainer) -> dict[str, bytes]:
    """All tensors that the next step depends on."""
    return {name: t.contiguous().numpy().tobytes() for name, t in trainer.tensors().items()}


def bits(trainer: Trainer) -> tuple[dict[str, bytes], dict[str, Any]]:
    """All tensors and all other state of the next step."""
    return tensor_bits(trainer), trainer.state()
