"""Steps in flight; oracle: the same training with its results read at other times."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gscore.stress.capture import ToyPhotos
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.step.step_result import StepResult
from gscore.trainer.trainer import Trainer
from gscore.trainer.views.photo_gains import PhotoGains
from tests.engine.fake_engine import Answer, FakeEngine, FakeModel
from tests.trainer.short_run import CONFIG

DEPTHS = [0, 2]


def trainer_of(photos: ToyPhotos, engine: Any, *, gains: bool = False, **options: Any) -> Trainer:
    """A trainer on this engine, which refines gains or not."""
    start = PhotoGains(photos.train, np.zeros((len(photos.train), 3))) if gains else None
    config = replace(CONFIG, exposure_lr=0.01, **options)
    return Trainer(config, Analysis(photos=photos, gains=start), engine)


def run(trainer: Trainer, steps: int, read_at: tuple[int, ...] = ()) -> list[StepResult]:
    """The results of some steps, all read after the steps `read_at` and at the end."""
    results = []
    for _ in range(steps):
        results += trainer.advance()
        if trainer.steps in read_at:
            results += trainer.read_all()
    return results + trainer.read_all()


def bits(trainer: Trainer) -> dict[str, bytes]:
    """All tensors of a trainer."""
    return {name: tensor.numpy().tobytes() for name, tensor in trainer.tensors().items()}


@pytest.mark.parametrize("depth", DEPTHS)
def test_as_many_steps_are_in_flight_as_the_engine_allows(photos: ToyPhotos, depth: int) -> None:
    """Oracle: the most unread steps, and the results one by one, late by the depth, except where
    rows are edited at every tenth step."""
    engine = FakeEngine(depth)
    trainer = trainer_of(photos, engine, photo_blur=False, transient_masks=False)
    read = [[result.step for result in trainer.advance()] for _ in range(14)]
    assert engine.most_unread == depth + 1
    assert read[9][-1] == 10
    assert [steps for steps in read[:9] if steps] == [[step] for step in range(1, 10 - depth)]
    assert [result.step for result in trainer.read_all()] == list(range(15 - depth, 15))


@pytest.mark.parametrize("gains", [False, True])
def test_a_training_does_not_depend_on_when_results_are_read(
    photos: ToyPhotos, gains: bool
) -> None:
    """Oracle: bits and results of the training that reads none early."""
    late = trainer_of(photos, FakeEngine(2), gains=gains)
    early = trainer_of(photos, FakeEngine(2), gains=gains)
    assert run(late, 37) == run(early, 37, read_at=(1, 4, 5, 18, 36))
    assert bits(late) == bits(early)
    assert late.state() == early.state()


def test_gains_are_late_by_the_depth(photos: ToyPhotos) -> None:
    """Oracle: without gains the depth changes no bit; with them the gains after step 7 are those
    after step 5."""
    plain = [trainer_of(photos, FakeEngine(depth)) for depth in DEPTHS]
    for trainer in plain:
        run(trainer, 33)
    assert bits(plain[0]) == bits(plain[1])
    now, late = (trainer_of(photos, FakeEngine(depth), gains=True) for depth in DEPTHS)
    run(now, 5)
    run(late, 7)
    assert now.photo_parameters.gains is not None and late.photo_parameters.gains is not None
    found = late.photo_parameters.gains.log_gains
    np.testing.assert_array_equal(found, now.photo_parameters.gains.log_gains)
    assert np.abs(found).max() > 0


@pytest.mark.parametrize("depth", DEPTHS)
def test_a_restored_training_goes_on_with_the_same_bits(photos: ToyPhotos, depth: int) -> None:
    """Oracle: the uninterrupted training; slopes that were not used yet are part of the state."""
    whole = trainer_of(photos, FakeEngine(depth), gains=True)
    run(whole, 18)
    state = whole.state()
    tensors = {name: tensor.clone() for name, tensor in whole.tensors().items()}
    assert ("slopes" in tensors) == (depth > 0)
    after = trainer_of(photos, FakeEngine(depth), gains=True)
    after.restore(state, tensors)
    for trainer in (whole, after):
        run(trainer, 20)
    assert bits(whole) == bits(after)
    assert whole.state() == after.state()


def test_broken_slopes_are_refused(photos: ToyPhotos) -> None:
    """Oracle: the sentence."""
    trainer = trainer_of(photos, FakeEngine(2), gains=True)
    run(trainer, 5)
    tensors = {name: tensor.clone() for name, tensor in trainer.tensors().items()}
    tensors["slopes"] = tensors["slopes"][:, :20]
    with pytest.raises(ValueError, match="expected 21 numbers a photo"):
        trainer.restore(trainer.state(), tensors)


class ReversedEngine(FakeEngine):
    """A fake engine that computes its numbers when a result is read, the last step first."""

    def __init__(self, in_flight: int) -> None:
        super().__init__(in_flight)
        self.waiting: list[Answer] = []
        self.order: list[int] = []

    def step(self, model: FakeModel, request: Any) -> Any:
        answer = super().step(model, request)
        self.waiting.append(answer)
        return _Late(self, answer)


class _Late:
    def __init__(self, engine: ReversedEngine, answer: Answer) -> None:
        self.engine, self.answer = engine, answer

    def result(self) -> Any:
        while self.engine.waiting:
            self.engine.order.append(self.engine.waiting.pop().numbers.step)
        return self.answer.result()


def test_steps_may_end_late_and_in_any_order(photos: ToyPhotos) -> None:
    """Oracle: bits and results of an engine that answers at once and in order."""
    engine = ReversedEngine(2)
    trainer, plain = (trainer_of(photos, one, gains=True) for one in (engine, FakeEngine(2)))
    assert run(trainer, 25) == run(plain, 25)
    assert bits(trainer) == bits(plain)
    assert engine.order != sorted(engine.order)


@pytest.mark.parametrize("depth", DEPTHS)
def test_ensembles_have_steps_in_flight_too(photos: ToyPhotos, depth: int) -> None:
    """Oracle: the training without steps in flight; a step counts once for all of its models."""
    engine = FakeEngine(depth)
    trainer = trainer_of(photos, engine, ensemble=2)
    plain = trainer_of(photos, FakeEngine(), ensemble=2)
    assert run(trainer, 22) == run(plain, 22)
    assert bits(trainer) == bits(plain)
    assert engine.most_unread == depth + 1
