"""Trainings that need more than a device's memory; oracle: the sentence, and what it proposes."""

import re
from dataclasses import replace

import pytest

from gscore.config import TrainConfig
from gscore.raster.gpu.library import DeviceMemoryError
from gscore.trainer.estimate.forecast import Estimate, check_fits, estimate

MIB = 1 << 20


def of_device(config: TrainConfig, width: int, memory: int) -> Estimate:
    """The forecast with photos of this width, on a device with this memory."""
    size = width, 3 * width // 4
    return estimate(config, [size], points=100, device_memory=memory, free=1 << 40, pace=1.0)


@pytest.mark.parametrize(
    ("splats", "width", "memory", "words"),
    [
        (10_000, 20_000, 1024 * MIB, r"use smaller photos \(`--resolution (\d+)`\)"),
        (6_000_000, 1600, 8192 * MIB, r"use `--max-splats (\d+)`"),
    ],
)
def test_a_training_beyond_a_device_is_refused_with_what_fits(
    splats: int, width: int, memory: int, words: str
) -> None:
    """Oracle: a photo larger than the memory, and millions of splats on a small card: what the
    sentence proposes is accepted, and a hundredth more is not."""
    config = TrainConfig(max_splats=splats)
    with pytest.raises(DeviceMemoryError, match=words) as raised:
        check_fits(of_device(config, width, memory), config, "card")
    found = re.search(words, str(raised.value))
    assert found
    number = int(found[1])

    def changed(value: int) -> Estimate:
        if width > 1600:
            return of_device(config, value, memory)
        return of_device(replace(config, max_splats=value), width, memory)

    check_fits(changed(number), config, "card")
    with pytest.raises(DeviceMemoryError):
        check_fits(changed(number + number // 100), config, "card")
