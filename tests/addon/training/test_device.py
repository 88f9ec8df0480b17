"""The device that trains: that of the preferences, and its name in the panel."""

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy
import pytest

from addon import preferences
from addon.core import Started
from addon.panels import progress
from addon.panels.train import TrainOptionsPanel, TrainPanel
from addon.training import options, run_state, start_training
from addon.training.run_state import RunState
from tests.addon.drawn import drawn
from tests.addon.fake_trainer import STARTED
from tests.addon.trainings import positions, until
from tests.addon.vulkan_device import passed_device

REAL = os.environ.get("GSCORE_TRAINER_PYTHON", "")
CARD = "0123456789abcdef0123456789abcdef"


@pytest.fixture
def prefs() -> Iterator[preferences.Preferences]:
    """The preferences with a found card, which is not chosen; restored afterwards."""
    found = preferences.get()
    found.found_devices, found.device = json.dumps([[CARD, "Card"]]), preferences.CPU
    yield found
    found.device, found.found_devices = preferences.CPU, ""


def started(device: str, asked: str) -> Started:
    """The first event of a run on `device`, of which its options ask `asked`."""
    facts = {name: value for name, value in STARTED.items() if name != "event"}
    return Started(**facts | {"device": device, "config": {"train": {"device": asked}}})


def shown(*events: Started) -> str:
    """The device in the panel after events."""
    state = RunState()
    for event in events:
        state.apply(event)
    return dict(progress.numbers(state))["Device"]


@pytest.mark.parametrize(("chosen", "word"), [("CPU", "cpu"), ("AUTO", "auto"), (CARD, CARD)])
def test_a_training_gets_the_device(
    studio: bpy.types.Scene,
    prefs: preferences.Preferences,
    play: Callable[..., Path],
    monkeypatch: pytest.MonkeyPatch,
    chosen: str,
    word: str,
) -> None:
    """Oracle: the arguments of the process; resumed runs and sequences have the same."""
    prefs.device = chosen
    monkeypatch.setattr(preferences, "no_automatic_card", lambda: "There is no graphics card.")
    arguments = play({"say": STARTED}, {"sleep": 600})
    job = start_training.train(studio, overwrite=True)
    until(lambda: job.state.started is not None)
    machine = start_training.machine()
    again = options.resumed_run(source=None, output=Path("o"), machine=machine)
    own = studio.gscore_train_sequence
    frames = options.resumed_sequence(own, output=Path("o"), machine=machine)
    for line in (json.loads(arguments.read_text()), again, frames):
        assert line[line.index("--device") + 1] == word
        # Where a card may train, a part of its time is the viewport's.
        assert ("--gpu-share" in line) == (chosen == CARD)
        assert chosen != CARD or line[line.index("--gpu-share") + 1] == "0.8"


def test_the_panel_names_the_device() -> None:
    """Oracle: the events; a CPU in place of a card that failed is named."""
    assert shown(started("cpu", "cpu")) == "CPU"
    assert shown(started("Card", "auto")) == "Card"
    assert shown(started("cpu", "auto")) == "CPU"
    assert shown(started("Card", "auto"), started("cpu", "cpu")) == "CPU, without a graphics card"
    older = {name: value for name, value in STARTED.items() if name != "event"}
    assert shown(Started(**older)) == "CPU"


def test_a_crash_names_the_driver() -> None:
    """Oracle: the name of the device; the CPU has no driver."""
    sentences = []
    for device in ("Card", "cpu"):
        state = RunState()
        state.apply(started(device, device))
        state.end(-11, [], python="python")
        sentences.append(state.sentence)
    assert "memory ran out or the driver of Card crashed: use fewer splats" in sentences[0]
    assert "memory ran out: use fewer splats" in sentences[1]


def test_options_have_the_device(studio: bpy.types.Scene, prefs: preferences.Preferences) -> None:
    """Oracle: the field of the preferences, and what the forecast is for."""
    assert "<device> ()" in drawn(TrainOptionsPanel)
    until(lambda: "of memory" in drawn(TrainPanel))
    assert "graphics card" not in drawn(TrainPanel)
    prefs.device = CARD
    assert "That is for the CPU" in drawn(TrainPanel)


@pytest.mark.slow  # a device in software compiles all kernels of a training
@pytest.mark.skipif(not REAL, reason="GSCORE_TRAINER_PYTHON names no Python")
def test_a_training_on_a_device_of_this_machine(
    studio: bpy.types.Scene,
    prefs: preferences.Preferences,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Oracle: the name of the device, and the splats in the trainer's file."""
    from addon.core import read_splats

    uuid, name = passed_device(REAL, tmp_path / "cache", monkeypatch)
    prefs.found_devices = json.dumps([[uuid, name]])
    prefs.python_path, prefs.device = REAL, uuid
    settings = studio.gscore
    settings.iterations, settings.resolution, settings.width, settings.eval = 3, "WIDTH", 40, False
    job = start_training.train(studio, wait=True)
    assert job.state.status == run_state.FINISHED, job.state.sentence
    assert job.state.device == name and not job.state.replaces_card
    trained = read_splats(tmp_path / "out" / "point_cloud.ply")
    assert (positions(settings.result) == trained.means).all()
