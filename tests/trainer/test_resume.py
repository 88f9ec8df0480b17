"""Interrupted and resumed runs; oracle: bit equality with an uninterrupted one."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gscore.config import DataConfig, Strategy
from gscore.config_file import to_dict
from gscore.events import Warn
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.files import checkpoint
from gscore.trainer.run import train
from gscore.trainer.trainer import Trainer
from tests.trainer.short_run import CONFIG
from tests.trainer.trainer_bits import bits

pytestmark = pytest.mark.usefixtures("fake_engine")

STOPS = (1, 5, 8, 9, 10, 12, 13, 19, 20, 21, 25, 26, 33, 59)
"""Before and after refinements (10, 20), resets (25), SH degrees (12) and epochs (8)."""


@pytest.fixture
def near(make_photos: Callable[..., Any]) -> Any:
    """The toy capture with such long lenses that no view shows every splat."""
    photos = make_photos()
    photos.scene.cameras.Ks[:, :2, :2] *= 3
    return photos


@pytest.mark.parametrize("strategy", list(Strategy))
def test_resume_is_bit_equal(photos: Any, tmp_path: Path, strategy: Strategy) -> None:
    """Oracle: all tensors and all other state after the last step, from checkpoints on disk."""
    config = replace(CONFIG, strategy=strategy)
    whole = Trainer(config, Analysis(photos=photos))
    for step in range(1, 61):
        whole.step()
        if step in STOPS:
            checkpoint.save(tmp_path / f"{step}.safetensors", whole, {})
    assert len(whole.model) > 150
    assert whole.model.sh_degree == 3
    for stop in STOPS:
        found = checkpoint.load(tmp_path / f"{stop}.safetensors")
        checkpoint.check_compatible(found, config, photos)
        resumed = Trainer(config, Analysis(photos=photos))
        resumed.restore(found.trainer, found.tensors)
        assert resumed.steps == stop
        while resumed.steps < 60:
            resumed.step()
        assert bits(resumed) == bits(whole), f"resumed at step {stop}"


@pytest.mark.usefixtures("real_engine")
@pytest.mark.parametrize("strategy", list(Strategy))
def test_resume_while_gradients_gather_is_bit_equal(
    near: Any, tmp_path: Path, strategy: Strategy
) -> None:
    """Oracle: as above, between two steps of the higher SH coefficients, which use the accumulated
    gradients of four views, in the visible rows."""
    config = replace(CONFIG, strategy=strategy, shN_every=4)
    whole, stops = Trainer(config, Analysis(photos=near)), (14, 22, 35, 59)
    for step in range(1, 61):
        whole.step()
        if step in stops:
            checkpoint.save(tmp_path / f"{step}.safetensors", whole, {})
            assert whole.tensors()["gathered/shN"].any()
            seen = whole.model.rows["shN_visible"]
            assert seen.any() and not seen.all()
    for stop in stops:
        found = checkpoint.load(tmp_path / f"{stop}.safetensors")
        resumed = Trainer(config, Analysis(photos=near))
        resumed.restore(found.trainer, found.tensors)
        while resumed.steps < 60:
            resumed.step()
        assert bits(resumed) == bits(whole), f"resumed at step {stop}"


@pytest.mark.usefixtures("real_engine")
def test_resume_with_other_threads_is_bit_equal(photos: Any, tmp_path: Path) -> None:
    """Oracle: as above, with another number of threads after the resume."""
    whole = Trainer(replace(CONFIG, threads=1), Analysis(photos=photos))
    for _ in range(15):
        whole.step()
    checkpoint.save(tmp_path / "c.safetensors", whole, {})
    found = checkpoint.load(tmp_path / "c.safetensors")
    other = replace(CONFIG, threads=2)
    checkpoint.check_compatible(found, other, photos)
    resumed = Trainer(other, Analysis(photos=photos))
    resumed.restore(found.trainer, found.tensors)
    for _ in range(15):
        whole.step()
        resumed.step()
    assert bits(resumed) == bits(whole)


def test_a_run_with_a_removed_option_goes_on(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the steps of the resumed run; one warning with name, value and what holds now."""
    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "to_dict", lambda one: to_dict(one) | {"grow_scale": 0.02})
        data, config = DataConfig(source=capture), replace(CONFIG, iterations=2)
        train(config, data, tmp_path / "out")
    events: list[Any] = []
    longer = replace(config, iterations=3)
    assert train(longer, data, tmp_path / "out", events.append, resume=True).steps == 3
    told = [one.message for one in events if isinstance(one, Warn) and "grow_scale" in one.message]
    assert len(told) == 1
    assert told[0].endswith("grow_scale 0.02 has no effect: splats above 0.01 extents are split.")
