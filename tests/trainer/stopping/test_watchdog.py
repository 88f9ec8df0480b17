"""Runs that diverge; oracle: closed forms of the decisions, and real runs at absurd rates."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gscore.config import DataConfig, TrainConfig
from gscore.control import Control
from gscore.errors import GsError
from gscore.events import Event, Saved, Warn
from gscore.trainer.files.run_folder import RunFolder
from gscore.trainer.run import train
from gscore.trainer.schedule import plan
from gscore.trainer.schedule.plan import Plan
from gscore.trainer.stopping.watchdog import MAX_RESCUES, SLOWER, Watchdog

CONFIG = TrainConfig(
    iterations=320, max_splats=200, sh_degree=0, refine_start=400, checkpoint_seconds=1e9, threads=1
)
ABSURD = replace(CONFIG, scales_lr=2.0)
"""Splats fill the screen within some steps; at a fifth of a fifth the run is sound."""


def dog(**options: Any) -> Watchdog:
    plan = Plan.of(
        TrainConfig(iterations=20_000, **options), extent=1.0, points=100, side=100, pixels=10_000
    )
    watching = Watchdog(plan)
    watching.start(0.3)
    watching.keep(0)
    return watching


def feed(watching: Watchdog, errors: list[float], *, first: int = 1) -> int | None:
    """The step at which the watchdog reports."""
    for step, error in enumerate(errors, start=first):
        if watching.observe(step, error * error, skipped=not math.isfinite(error)):
            return step
    return None


def test_falling_noisy_and_level_errors_are_healthy() -> None:
    """Oracle: a run with a falling error and single views four times as bad as others."""
    errors = [0.3 / (1 + step / 100) * (2.0 if step % 8 == 0 else 0.9) for step in range(3000)]
    assert feed(dog(), errors) is None


def test_holes_that_fill_are_no_divergence() -> None:
    """Oracle: an error that triples when a refinement leaves holes and falls within a hundred
    steps, twice; the same without the fall, and a fall too late."""
    filled = [0.1] * 300 + [0.4 - 0.003 * k for k in range(100)] + [0.1] * 300
    assert feed(dog(), filled * 2) is None
    assert feed(dog(), filled[:301] + [0.4] * 200) is not None
    assert feed(dog(), filled[:301] + [0.4] * 150 + filled[301:]) is not None


def test_a_bad_end_is_a_divergence() -> None:
    """Oracle: fifty bad steps before the last one of the plan, or long before it."""
    errors = [0.1] * 300 + [0.5] * 50
    assert feed(dog(), errors, first=20_000 - len(errors) + 1) == 20_000
    assert feed(dog(), errors, first=10_000) is None


@pytest.mark.parametrize("bad", [0.5, 0.9, 30.0])
def test_an_explosion_is_noticed(bad: float) -> None:
    """Oracle: 300 good steps, then an error far above 1.7 times the best."""
    watching = dog()
    assert feed(watching, [0.1] * 300) is None
    barked = feed(watching, [bad] * 200, first=301)
    assert barked is not None
    assert 450 <= barked <= 500  # patience of 150 steps, in the window of 50


def test_worse_than_the_start_is_noticed_even_if_it_was_never_better() -> None:
    """Oracle: the error before the first step, 0.3."""
    assert feed(dog(), [0.6] * 200) == 50 + 149
    assert feed(dog(), [0.45] * 500) is None


def test_a_model_that_loses_half_of_its_splats_is_noticed() -> None:
    """Oracle: a tenth per check, more than half at the sixth check. A few splats are no reason."""
    watching = dog()
    assert [watching.observe(s, 0.01, skipped=False, lost=0.1) for s in range(1, 7)].index(
        True
    ) == 5
    with pytest.raises(GsError, match="60% of the splats had runaway values"):
        for _ in range(MAX_RESCUES + 1):
            watching.rescue(6)
            watching.observe(7, 0.01, skipped=False, lost=0.6)
    watching = dog()
    assert not any(watching.observe(s, 0.01, skipped=False, lost=1e-4) for s in range(1, 3000))
    looks = ((s, 0.002 if s % 100 == 0 else 0.0) for s in range(1, 30_000))
    assert not any(watching.observe(s, 0.01, skipped=False, lost=lost) for s, lost in looks)


def test_losses_that_are_not_finite_are_noticed_while_single_ones_pass() -> None:
    """Oracle: one in three for long, then all."""
    errors = [math.nan if step % 3 == 0 else 0.1 for step in range(600)]
    watching = dog()
    assert feed(watching, errors) is None
    barked = feed(watching, [math.nan] * 60, first=601)
    assert barked is not None


def test_lowered_opacities_are_no_divergence() -> None:
    """Oracle: resets at 3000 and 6000, after which the error is high for a thousand steps."""
    watching = dog()
    errors = [0.3 if 3000 <= step < 4200 or 6000 <= step < 7200 else 0.1 for step in range(1, 9000)]
    assert feed(watching, errors) is None
    assert feed(watching, [0.4] * 200, first=10_001) is not None


def test_rescues_go_back_further_each_time_and_end() -> None:
    """Oracle: the two last good states, then the older one again; an error the fourth time."""
    watching = dog(reset_every=-1)
    for step in (2000, 4000, 6000):
        feed(watching, [0.1] * 2000, first=step - 1999)
        assert watching.worth_keeping(step)
        watching.keep(step)
    assert watching.good == (4000, 6000)
    assert [watching.rescue(6500), watching.rescue(6100), watching.rescue(4100)] == [
        6000,
        4000,
        4000,
    ]
    assert watching.rate_factor == pytest.approx(SLOWER**3)
    with pytest.raises(GsError, match=r"diverged again, after 3 rescues .* Lower the"):
        watching.rescue(4200)


def test_its_state_comes_back() -> None:
    """Oracle: the same decisions of both from there on."""
    one, other = dog(), dog()
    feed(one, [0.1] * 2000)
    one.keep(2000)
    assert feed(one, [0.5] * 80, first=2001) is None
    other.restore(one.state())
    assert other.state() == one.state()
    assert feed(one, [0.5] * 90, first=2081) == feed(other, [0.5] * 90, first=2081) is not None


FADING = replace(CONFIG, sh0_lr=8.0)
"""Splats of a fake engine brighten beyond any photo; at a fifth of a fifth they do not."""


def run(config: TrainConfig, capture: Path, output: Path, **options: Any) -> list[Event]:
    events: list[Event] = []
    train(config, DataConfig(source=capture), output, events.append, **options)
    return events


@pytest.fixture
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    """Good states every 60 steps, so that a short run has some."""
    monkeypatch.setattr(plan, "_KEPT_EVERY", 60)


@pytest.mark.usefixtures("often")
def test_a_run_at_absurd_rates_is_rescued(capture: Path, tmp_path: Path) -> None:
    """Oracle: a worse end of the same run without the watchdog; every rescue is reported and
    kept."""
    alone, rescued = tmp_path / "alone", tmp_path / "rescued"
    run(replace(ABSURD, watchdog=False), capture, alone)
    events = run(ABSURD, capture, rescued)
    messages = [e.message for e in events if isinstance(e, Warn) and e.code == "diverged"]
    assert 1 <= len(messages) <= MAX_RESCUES
    assert "It continues from step" in messages[0]
    assert messages[0] in (rescued / "report.html").read_text().replace("&#x27;", "'")
    psnr = [json.loads((p / "metrics.json").read_text())["psnr"] for p in (alone, rescued)]
    assert psnr[1] > psnr[0] + 0.5  # by 1 to 4 dB, depending on rounding and seed
    steps = [e["step"] for e in json.loads((rescued / "metrics.json").read_text())["history"]]
    assert steps == sorted(set(steps))
    assert [p.name for p in RunFolder(rescued).checkpoints()] == ["step_00000320.safetensors"]


@pytest.mark.usefixtures("often", "fake_engine")
@pytest.mark.parametrize("coarse", [1.0, 4.0])
def test_a_rescued_run_that_is_stopped_goes_on_to_the_same_bits(
    capture: Path, tmp_path: Path, coarse: float
) -> None:
    """Oracle: the bytes of point_cloud.ply of an uninterrupted run, for stops before, right after
    and long after the rescues; with photos of one size, and of sizes that a rescue reverts."""
    absurd = replace(FADING, coarse_factor=coarse)
    events = run(absurd, capture, tmp_path / "whole")
    rescues = [e.message for e in events if isinstance(e, Warn) and e.code == "diverged"]
    assert len(rescues) >= 2
    expected = (tmp_path / "whole" / "point_cloud.ply").read_bytes()
    for stop, rescues in ((30, 0), (70, 0), (200, 0), (10, 1), (10, 2)):
        output = tmp_path / f"{stop}-{rescues}"
        config = replace(absurd, snapshot_every=stop)
        _stopped(config, capture, output, rescues=rescues)
        run(config, capture, output, resume=True)
        assert (output / "point_cloud.ply").read_bytes() == expected, (stop, rescues)


def _stopped(config: TrainConfig, capture: Path, output: Path, *, rescues: int) -> None:
    """A run stopped at its first snapshot after this number of rescues."""
    control, seen = Control(), 0

    def watch(event: Event) -> None:
        nonlocal seen
        seen += isinstance(event, Warn) and event.code == "diverged"
        if event.kind == "snapshot" and seen >= rescues:
            control.stop()

    train(config, DataConfig(source=capture), output, watch, control)


def test_a_run_that_cannot_be_rescued_ends_with_an_error(capture: Path, tmp_path: Path) -> None:
    """Oracle: rates a million times too high; a message with a remedy, and kept checkpoints."""
    config = replace(CONFIG, scales_lr=1e6, sh0_lr=1e6)
    with pytest.raises(GsError, match=r"diverged again, after 3 rescues"):
        run(config, capture, tmp_path)
    assert RunFolder(tmp_path).checkpoints()


def test_without_checkpoints_a_diverged_run_ends_at_once(capture: Path, tmp_path: Path) -> None:
    """Oracle: no state to go back to; with the watchdog off the run continues."""
    config = replace(ABSURD, checkpoint_seconds=0.0)
    with pytest.raises(GsError, match=r"Training diverged: at step \d+ \d\d% of the splats"):
        run(config, capture, tmp_path)
    events = run(replace(config, watchdog=False), capture, tmp_path, overwrite=True)
    assert events[-1].kind == "done"


def test_a_healthy_run_is_not_touched(capture: Path, tmp_path: Path) -> None:
    """Oracle: the bytes of the same run without a watchdog, and only the last checkpoint as a
    file."""
    events = run(CONFIG, capture, tmp_path / "with")
    run(replace(CONFIG, watchdog=False), capture, tmp_path / "without")
    assert not [e for e in events if isinstance(e, Warn)]
    assert [e.step for e in events if isinstance(e, Saved)] == [320, 320]
    files = [(tmp_path / name / "point_cloud.ply").read_bytes() for name in ("with", "without")]
    assert files[0] == files[1]
