"""An engine written by the protocol and its docs alone; oracle: the CPU engine, and photos."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from gscore.config import TrainConfig
from gscore.engine.cpu.engine import CpuEngine
from gscore.stress.capture import toy_photos, toy_splats
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.trainer import Trainer
from tests.engine import small_engine


def trained(engine: Any) -> tuple[list[float], float]:
    """Losses of the steps of a short training, and its gain in PSNR of the training views, dB."""
    photos = toy_photos(splats=toy_splats(count=40), size=20)
    config = TrainConfig(
        iterations=40,
        max_splats=80,
        sh_degree=1,
        sh_every=10,
        refine_start=100,
        photo_blur=False,
        transient_masks=False,
    )
    trainer = Trainer(config, Analysis(photos=photos), engine)
    before = trainer.error()
    losses = [trainer.step().loss for _ in range(config.iterations)]
    return losses, 20 * math.log10(before / trainer.error())


def test_a_short_training_improves_photos_as_on_the_cpu() -> None:
    """Oracle: the losses of the CPU engine, step by step, SH coefficients included."""
    losses, gain = trained(small_engine.SmallEngine())
    expected, gain_on_cpu = trained(CpuEngine(threads=1))
    np.testing.assert_allclose(losses, expected, rtol=0.01)
    assert gain > 1 and abs(gain - gain_on_cpu) < 0.05


def test_it_is_as_short_as_the_docs_promise() -> None:
    """Oracle: the number in docs/extending.md."""
    assert len(Path(small_engine.__file__).read_text().splitlines()) <= 150
