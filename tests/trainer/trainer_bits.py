"""Bits of a trainer, for comparisons of trainings."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from gscore.config import TrainConfig
from gscore.stress.capture import ToyPhotos
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.files import checkpoint
from gscore.trainer.trainer import Trainer


def tensor_bits(trainer: Trainer) -> dict[str, bytes]:
    """All tensors that the next step depends on."""
    return {name: t.contiguous().numpy().tobytes() for name, t in trainer.tensors().items()}


def bits(trainer: Trainer) -> tuple[dict[str, bytes], dict[str, Any]]:
    """All tensors and all other state of the next step."""
    return tensor_bits(trainer), trainer.state()


def compare_resumed(
    config: TrainConfig, photos: ToyPhotos, folder: Path, stops: Sequence[int]
) -> Trainer:
    """Compare trainings that are resumed, with two threads, from checkpoints after `stops` with an
    uninterrupted one, bit by bit; returns its trainer."""
    whole = Trainer(config, Analysis(photos=photos))
    for step in range(1, config.iterations + 1):
        whole.step()
        if step in stops:
            checkpoint.save(folder / f"{step}.safetensors", whole, {})
    for stop in stops:
        found = checkpoint.load(folder / f"{stop}.safetensors")
        resumed = Trainer(replace(config, threads=2), Analysis(photos=photos))
        resumed.restore(found.trainer, found.tensors)
        while resumed.steps < config.iterations:
            resumed.step()
        assert bits(resumed) == bits(whole), f"resumed at step {stop}"
    return whole
