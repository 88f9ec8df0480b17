"""`auto` of trainings: a software device that counts as a card, and times that are given."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gscore.config import DataConfig, Skip, TrainConfig
from gscore.engine.cpu.engine import CpuEngine
from gscore.engine.trial import step_seconds
from gscore.events import Started, Warn
from gscore.raster.gpu import absence
from gscore.raster.gpu.choice import Chosen
from gscore.raster.gpu.devices import Device
from gscore.raster.gpu.library import DeviceLostError
from gscore.raster.gpu.verdict import DeviceVerdict, keep_verdict
from gscore.trainer import run
from gscore.trainer.estimate import automatic_device
from tests.gpu.engines import software_engine

CONFIG = TrainConfig(iterations=4, checkpoint_iterations=(2,))
Trial = Callable[..., float]


@pytest.fixture
def as_card(device: Device, monkeypatch: pytest.MonkeyPatch) -> Callable[[Trial], list[str]]:
    """Makes `auto` choose the first device, which takes the given time in a trial; returns the
    list of the names that were to be chosen from then on."""
    asked: list[str] = []

    def choose(name: str, **_: Any) -> Chosen:
        asked.append(name)
        return Chosen(device=device, fallback=True)

    def install(trial: Trial) -> list[str]:
        monkeypatch.setattr(automatic_device, "choose", choose)
        monkeypatch.setattr(automatic_device, "step_seconds", trial)
        monkeypatch.setattr(automatic_device, "_trials", {})
        return asked

    return install


def _train(capture: Path, output: Path, **options: Any) -> tuple[Any, list[Any]]:
    events: list[Any] = []
    config = replace(CONFIG, **options.pop("config", {}))
    done = run.train(config, DataConfig(source=capture), output, events.append, **options)
    return done, events


def _decision(events: list[Any]) -> str:
    """The decision on the device; empty: none."""
    (started,) = (one for one in events if isinstance(one, Started))
    return started.decision("chosen_device")


def _warnings(events: list[Any]) -> list[str]:
    return [one.message for one in events if isinstance(one, Warn) and one.code == run.DEVICE]


def test_a_faster_card_trains(as_card, device: Device, capture: Path, tmp_path: Path) -> None:
    """Oracle: the device and both times in the event and metrics.json, `auto` in config.json; the
    expected time has the pace of the trial."""
    as_card(lambda *_, **__: 1e-6)
    done, events = _train(capture, tmp_path)
    assert done.steps == 4 and not _warnings(events)
    text = _decision(events)
    assert text.startswith(f"{device.name} trains: in a trial it took 0.001 ms a step with ")
    assert ", the CPU about " in text
    metrics = json.loads((tmp_path / "metrics.json").read_text(encoding="utf-8"))
    assert metrics["decisions"][0] == {"topic": "chosen_device", "text": text}
    assert metrics["machine"]["isa"].startswith("gpu: ")
    assert json.loads((tmp_path / "config.json").read_text())["train"]["device"] == "auto"
    (started,) = (one for one in events if isinstance(one, Started))
    assert started.left_s < 1e-3


def test_options_of_a_card_are_used_where_one_trains(
    as_card, capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the config of the event, on a card and on a CPU that takes over from one."""
    monkeypatch.setattr(Device, "is_software", False)
    options = DataConfig(source=capture, max_width=20), replace(CONFIG, iterations=3)
    for name, trial, fault in (("card", 1e-6, ""), ("cpu", 1e3, ""), ("lost", 1e-6, "lost:s3")):
        monkeypatch.setenv("GSCORE_GPU_FAULT", fault)
        as_card(lambda *_, trial=trial, **__: trial)
        _, events = _train(capture, tmp_path / name, on_card=options)
        started = [one for one in events if isinstance(one, Started)]
        wanted = (4, 48) if name == "cpu" else (3, 20)
        assert [(one.iterations, one.width) for one in started] == [wanted] * len(started)
        assert len(started) == 1 + (name == "lost")


def test_a_run_that_the_cpu_took_over_is_resumed_with_the_options_of_the_card(
    as_card, capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the size of the photos and the steps, where the CPU is now faster."""
    monkeypatch.setattr(Device, "is_software", False)
    as_card(lambda *_, **__: 1e-6)
    monkeypatch.setenv("GSCORE_GPU_FAULT", "lost:s2")
    photos = DataConfig(source=capture, max_width=20)
    _train(capture, tmp_path, on_card=(photos, replace(CONFIG, iterations=3)))
    monkeypatch.delenv("GSCORE_GPU_FAULT")
    as_card(lambda *_, **__: 1e3)
    more = photos, replace(CONFIG, iterations=6)
    done, events = _train(capture, tmp_path, on_card=more, resume=True)
    (started,) = (one for one in events if isinstance(one, Started))
    assert (started.device, started.width, done.steps) == ("cpu", 20, 6)


def test_a_resumed_run_keeps_the_options_of_a_card_that_fails(
    as_card, capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the config of the events, on the card and on the CPU that takes over; a run without
    steps left is complete."""
    monkeypatch.setattr(Device, "is_software", False)
    as_card(lambda *_, **__: 1e-6)
    photos, more = DataConfig(source=capture, max_width=20), replace(CONFIG, iterations=6)
    first = photos, replace(CONFIG, iterations=3)
    assert not _train(capture, tmp_path, on_card=first)[0].ended_before
    assert _train(capture, tmp_path, on_card=first, resume=True)[0].ended_before
    monkeypatch.setenv("GSCORE_GPU_FAULT", "lost:s2")
    done, events = _train(capture, tmp_path, on_card=(photos, more), resume=True)
    started = [one for one in events if isinstance(one, Started)]
    assert [(one.iterations, one.width) for one in started] == [(6, 20)] * 2 and done.steps == 6
    assert started[1].device == "cpu"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"surface_weight": 1.0}, "--surface-weight"),
        ({"detect_anomaly": True}, "--detect-anomaly"),
        ({"without": (Skip.ZERO_TILE,)}, "--without zero-tile"),
    ],
)
def test_what_a_card_cannot_compute_is_trained_on_the_cpu(
    options: dict[str, Any],
    words: str,
    as_card,
    capture: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Oracle: the option in the decision, and a finished run; nothing is decided without a card."""
    asked = as_card(lambda *_, **__: 1e-6)
    done, events = _train(capture, tmp_path / "card", config=options)
    assert done.steps == 4 and not asked and not _warnings(events)
    text = _decision(events)
    assert text.startswith("The CPU trains: graphics cards do not compute ") and words in text
    monkeypatch.setattr(absence, "may_have_card", lambda: False)
    assert not _decision(_train(capture, tmp_path / "none", config=options)[1])


def test_a_slower_card_is_left_alone(as_card, capture: Path, tmp_path: Path) -> None:
    """Oracle: the bits of a training on the CPU, and both times in a sentence."""
    as_card(lambda *_, **__: 1e3)
    done, events = _train(capture, tmp_path / "auto")
    cpu, _ = _train(capture, tmp_path / "cpu", config={"device": "cpu"})
    assert done.splats.means.tobytes() == cpu.splats.means.tobytes()
    assert _decision(events).startswith("The CPU trains: in a trial ")
    assert not _warnings(events)


def test_a_card_that_fails_in_its_trial_is_named(as_card, capture: Path, tmp_path: Path) -> None:
    """Oracle: one sentence, and a finished run on the CPU."""

    def trial(*_: Any, **__: Any) -> float:
        raise DeviceLostError("The device was lost.")

    as_card(trial)
    done, events = _train(capture, tmp_path)
    assert done.steps == 4
    (text,) = _warnings(events)
    assert "failed in a trial. The device was lost." in text and _decision(events) == text


def test_a_card_whose_memory_others_use_is_named(
    as_card, capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: one sentence with the memory, and a finished run on the CPU."""
    as_card(lambda *_, **__: 1e-6)
    monkeypatch.setenv("GSCORE_GPU_MEMORY", "20")
    done, events = _train(capture, tmp_path, config={"max_splats": 10**6})
    assert done.steps == 4
    (text,) = _warnings(events)
    assert text.startswith("The CPU trains from the start, because the device failed: Training 1,0")
    assert [one.device for one in events if isinstance(one, Started)] == ["cpu"]


def test_a_resumed_run_keeps_its_device(as_card, capture: Path, tmp_path: Path) -> None:
    """Oracle: the device of the first part, whatever a trial would find; nothing is looked for
    where that was the CPU."""
    asked = as_card(lambda *_, **__: 1e3)
    for device in ("cpu", "0"):
        output = tmp_path / device
        first, _ = _train(capture, output, config={"device": device})
        asked.clear()
        config = {"iterations": 6, "device": "auto"}
        done, events = _train(capture, output, config=config, resume=True)
        assert first.steps == 4 and done.steps == 6
        assert done.metrics["machine"]["isa"] == first.metrics["machine"]["isa"]
        assert _decision(events).endswith(" trains, as before.") == (device == "0")
        assert asked == (["auto"] if device == "0" else [])


@pytest.fixture(autouse=True)
def passed(device: Device) -> None:
    """A verdict of the device."""
    keep_verdict(device.key, DeviceVerdict(passed=True))


def test_trials_are_shared_by_trainings_of_one_size(as_card, capture: Path, tmp_path: Path) -> None:
    """Oracle: the number of trials."""
    sizes = []
    as_card(lambda *_, **size: sizes.append(size) or 1e3)
    for name in "ab":
        _train(capture, tmp_path / name)
    assert len(sizes) == 1 and sizes[0]["sh_degree"] == 3 and sizes[0]["width"] > 0


@pytest.mark.parametrize("make", [CpuEngine, software_engine])
def test_a_trial_takes_steps(make: Callable[[], Any]) -> None:
    """Oracle: a time, of which the steps of the engine give the order."""
    engine = make()
    found = step_seconds(engine, splats=50, sh_degree=1, width=40, height=30, seconds=0.02)
    engine.close()
    assert 0 < found < 60


def test_no_trial_without_a_card(capture: Path, tmp_path: Path, monkeypatch) -> None:
    """Oracle: a size that must not be read; the reason where there may be a card, and nothing
    where there is none."""
    monkeypatch.setattr(run, "run_size", lambda *_: pytest.fail("read"))
    _, events = _train(capture, tmp_path / "software")
    assert "is a software device." in _decision(events) and not _warnings(events)
    monkeypatch.setattr(absence, "may_have_card", lambda: False)
    _, events = _train(capture, tmp_path / "none")
    assert not _decision(events) and not _warnings(events)
