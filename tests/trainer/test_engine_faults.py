"""Engines that fail; oracle: the last good state, one sentence, the events and the exit code."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gscore.commands import main
from gscore.config import DataConfig, TrainConfig
from gscore.errors import BackendError, GsError
from gscore.events import Event, Failed, Saved, Warn, from_line
from gscore.io.runs import checkpoints_in
from gscore.trainer.files.checkpoint import load
from gscore.trainer.run import train
from tests.engine.fake_engine import FakeEngine, Fault

CONFIG = TrainConfig(
    iterations=40,
    max_splats=200,
    sh_degree=1,
    refine_start=100,
    checkpoint_iterations=(20,),
    watchdog=False,
)
DEPTHS = pytest.mark.parametrize("depth", [0, 2])
Use = Callable[[FakeEngine], FakeEngine]


@pytest.fixture
def use(monkeypatch: pytest.MonkeyPatch) -> Use:
    """Makes trainings use an engine."""

    def place(engine: FakeEngine) -> FakeEngine:
        monkeypatch.setattr("gscore.engine.opening.CpuEngine", lambda **_: engine)
        return engine

    return place


def trained(capture: Path, out: Path, events: list[Event], **options: Any) -> Any:
    """Train on the toy capture, with all events."""
    data = DataConfig(source=capture, eval=True, test_every=4)
    resume = options.pop("resume", False)
    return train(replace(CONFIG, **options), data, out, on_event=events.append, resume=resume)


@DEPTHS
def test_a_run_without_faults_ends(use: Use, capture: Path, tmp_path: Path, depth: int) -> None:
    """Oracle: steps, engine and checkpoint of the results; the engine is closed."""
    engine = use(FakeEngine(depth))
    events: list[Event] = []
    result = trained(capture, tmp_path, events)
    assert (result.reason, result.steps) == ("finished", 40)
    assert result.metrics["machine"]["isa"] == "fake"
    assert load(next(iter(checkpoints_in(tmp_path).values()))).isa == "fake"
    assert [row["step"] for row in result.metrics["history"]] == list(range(1, 41))
    assert engine.most_unread == depth + 1
    assert engine.closed


@DEPTHS
@pytest.mark.parametrize(
    ("fault", "step", "words"),
    [
        (Fault.RAISES, 25, "The engine fake failed in step 25: RuntimeError: out of device memory"),
        (Fault.LOST, 25, "The engine fake failed in step 25: RuntimeError: VK_ERROR_DEVICE_LOST"),
        (Fault.OTHER_STEP, 25, "The engine fake answered step 24 instead of step 25"),
        (Fault.LOST_WHEN_SAVED, 40, "The engine fake failed while its state was read"),
    ],
)
def test_the_last_checkpoint_is_kept(
    use: Use, capture: Path, tmp_path: Path, depth: int, fault: Fault, step: int, words: str
) -> None:
    """Oracle: one sentence; the checkpoint of step 20, with which a sound engine ends the run as
    an uninterrupted one."""
    use(FakeEngine(depth, {step: fault}))
    events: list[Event] = []
    with pytest.raises(BackendError, match=words) as caught:
        trained(capture, tmp_path / "run", events)
    assert "The last checkpoint is kept; continue with `--resume`." in str(caught.value)
    assert list(checkpoints_in(tmp_path / "run")) == [20]
    assert not list((tmp_path / "run").rglob("*.tmp*"))
    assert [event.step for event in events if isinstance(event, Saved)] == [20]
    use(FakeEngine(depth))
    trained(capture, tmp_path / "run", events, resume=True)
    trained(capture, tmp_path / "whole", [])
    found = (tmp_path / "run/point_cloud.ply").read_bytes()
    assert found == (tmp_path / "whole/point_cloud.ply").read_bytes()


@DEPTHS
def test_one_step_without_a_number_is_skipped(
    use: Use, capture: Path, tmp_path: Path, depth: int
) -> None:
    """Oracle: a warning with the number of the step; the run ends."""
    use(FakeEngine(depth, {7: Fault.NAN}))
    events: list[Event] = []
    assert trained(capture, tmp_path, events).steps == 40
    said = [event.message for event in events if isinstance(event, Warn)]
    assert "Step 7: the loss was not usable; the step was skipped." in said


@DEPTHS
def test_a_run_without_numbers_goes_back_and_ends(
    use: Use, capture: Path, tmp_path: Path, depth: int
) -> None:
    """Oracle: three rescues to the first state, then the sentence of a diverged run."""
    use(FakeEngine(depth, dict.fromkeys(range(1, 400), Fault.NAN)))
    events: list[Event] = []
    with pytest.raises(GsError, match="diverged again, after 3 rescues"):
        trained(capture, tmp_path, events, iterations=300, watchdog=True, checkpoint_iterations=())
    rescues = [e for e in events if isinstance(e, Warn) and e.code == "diverged"]
    assert len(rescues) == 3 and "continues from step 0" in rescues[0].message
    assert list(checkpoints_in(tmp_path)) == [0]


@DEPTHS
@pytest.mark.parametrize(
    ("fault", "code"), [(Fault.LOST, 2), (Fault.RAISES, 2), (Fault.INTERRUPTED, 130)]
)
def test_the_command_ends_with_one_sentence(
    use: Use,
    capture: Path,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    depth: int,
    fault: Fault,
    code: int,
) -> None:
    """Oracle: exit code, a line of events, the checkpoint of step 20; an answer that never comes is
    left by Ctrl-C."""
    use(FakeEngine(depth, {25: fault}))
    options = ["--iterations", "40", "--checkpoint-iterations", "20", "--set", "refine_start=100"]
    command = ["train", str(capture), "-o", str(tmp_path), "--events", "jsonl", *options]
    assert main(command) == code
    out, err = capfd.readouterr()
    assert "Traceback" not in out + err
    assert 20 in checkpoints_in(tmp_path)
    if fault is not Fault.INTERRUPTED:
        last = from_line(out.splitlines()[-1])
        assert isinstance(last, Failed) and last.message.startswith("The engine fake failed")
