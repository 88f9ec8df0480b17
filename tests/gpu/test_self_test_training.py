"""Training kernels in the self-test. Oracle: numbers of the device that are changed a little on
their way to a check, which finds them."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np
import pytest

from gscore.raster.gpu import self_test_training
from gscore.raster.gpu.devices import Device
from gscore.raster.gpu.gpu_raster import GpuRaster
from gscore.raster.gpu.gpu_rows import GpuRows

Check = Callable[[str], str]
LOSSES = "of a picture", "masks and gains", "of a blurred picture"
STEP, WEIGHTS, ROWS = "training step", "blending weights", "rows of splats"
COUNT = count()


@pytest.fixture
def check(device: Device) -> Iterator[Check]:
    """Returns the problems of the check whose name has some words."""
    raster = GpuRaster(device.number)
    checks = self_test_training.training_checks

    def problems(words: str) -> str:
        (run,) = (run for name, run in checks() if words in name)
        return "; ".join(run(raster)[0])

    yield problems
    raster.close()


def changed(
    monkeypatch: pytest.MonkeyPatch, owner: Any, name: str, change: Callable[[Any], Any]
) -> None:
    """Let `change` replace the results of a function."""
    true = getattr(owner, name)
    monkeypatch.setattr(owner, name, lambda *args, **how: change(true(*args, **how)))


def test_a_device_passes(check: Check) -> None:
    assert [check(words) for words in (*LOSSES, STEP, WEIGHTS, ROWS)] == [""] * 6


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda one: replace(one, loss=one.loss + 2e-5), "it differs from the CPU's"),
        (lambda one: replace(one, v_image=one.v_image * 1.001), "its gradient differs"),
        (lambda one: replace(one, loss=one.loss + 1e-9 * next(COUNT)), "it changes when"),
    ],
)
def test_a_wrong_loss(check: Check, monkeypatch, change: Any, words: str) -> None:
    changed(monkeypatch, self_test_training, "gpu_image_loss", change)
    assert all(words in check(one) for one in LOSSES)


def test_a_device_that_does_not_blur(check: Check, monkeypatch) -> None:
    whole = self_test_training.gpu_image_loss
    monkeypatch.setattr(
        self_test_training,
        "gpu_image_loss",
        lambda *args, **how: whole(*args, **how | {"blur": None}),
    )
    assert [bool(check(words)) for words in LOSSES] == [False, False, True]


@pytest.mark.parametrize(
    ("name", "factor", "words"),
    [
        ("values means", 1 + 1e-4, "the step of means is wrong"),
        ("moment2 quats", 1.001, "the second moment of quats is wrong"),
        ("moment1 sh0", 1.01, "the gradient of sh0 differs from the CPU's"),
        ("viewmat", 1.01, "the gradient of viewmat differs from the CPU's"),
    ],
)
def test_a_wrong_step(check: Check, monkeypatch, name: str, factor: float, words: str) -> None:
    changed(
        monkeypatch,
        self_test_training,
        "_stepped",
        lambda found: found | {name: found[name] * factor},
    )
    assert words in check(STEP)


def test_a_step_that_changes(check: Check, monkeypatch) -> None:
    counts = iter((0, 1))

    def change(found: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return found | {"counters": found["counters"] + next(counts)}

    changed(monkeypatch, self_test_training, "_stepped", change)
    assert check(STEP) == "counters changes when the step is taken again"


def test_wrong_weights(check: Check, monkeypatch) -> None:
    changed(monkeypatch, GpuRaster, "weights", lambda found: found * 1.001)
    assert check(WEIGHTS).startswith("they differ from the CPU's by 1")


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("morton_order", lambda order: order[::-1], "their Morton order is wrong"),
        ("clamp", lambda lost: lost - 1, "rows that are not finite are not reset"),
    ],
)
def test_wrong_answers_of_rows(
    check: Check, monkeypatch, name: str, change: Any, words: str
) -> None:
    changed(monkeypatch, GpuRows, name, change)
    assert check(ROWS) == words


def test_rows_that_stay_as_they_were(check: Check, monkeypatch) -> None:
    """A device that leaves out noise, or the order of an edit."""
    rebuild = GpuRows.rebuild
    monkeypatch.setattr(GpuRows, "noise", lambda *_, **__: None)
    assert check(ROWS) == "their noise is wrong"
    monkeypatch.undo()
    monkeypatch.setattr(
        GpuRows, "rebuild", lambda self, rows, fresh: rebuild(self, np.sort(rows), 0 * fresh)
    )
    found = check(ROWS)
    assert all(f"{name} are in wrong rows after an edit" in found for name in ("quats", "sh0"))
