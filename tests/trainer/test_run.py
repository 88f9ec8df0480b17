"""Runs from a folder on disk to results; oracle: the events' contract and the files."""

import itertools
import json
import re
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gscore.commands.terminal.display import _texts
from gscore.config import DataConfig, Stereo, Switch, TrainConfig
from gscore.config_file import load_config
from gscore.control import Control
from gscore.datasets import load_dataset
from gscore.engine.base import StepRequest
from gscore.engine.cpu.engine import CpuEngine
from gscore.errors import BackendError, Cancelled, ConfigError, DatasetError, GsError
from gscore.events import (
    TOPICS,
    Done,
    Eval,
    Event,
    Preview,
    Progress,
    Saved,
    Snapshot,
    Started,
    Warn,
    from_line,
    to_line,
)
from gscore.io.cameras_json import read_cameras_json
from gscore.io.images.read_image import read_image
from gscore.io.metrics_file import metrics_problem, read_metrics
from gscore.io.ply.splats import read_ply, write_splats
from gscore.io.runs import checkpoints_in, read_course
from gscore.report import page as report_page
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.estimate import forecast
from gscore.trainer.estimate.forecast import estimate
from gscore.trainer.files.checkpoint import load
from gscore.trainer.files.run_folder import RunFolder
from gscore.trainer.run import train
from gscore.trainer.schedule import caps
from gscore.trainer.stopping import progress_meter
from gscore.trainer.trainer import Trainer
from gscore.trainer.views import photo_blurs, transients
from tests.engine.fake_engine import FakeEngine

pytestmark = pytest.mark.usefixtures("fake_engine")

CONFIG = TrainConfig(
    iterations=40, max_splats=200, sh_degree=1, refine_start=5, refine_every=5, grow_grad=1e-5
)


def data_of(capture: Path, **options: Any) -> DataConfig:
    return DataConfig(source=capture, eval=True, test_every=4, **options)


def test_a_report_knows_when_and_how_and_at_which_sizes(capture: Path, tmp_path: Path) -> None:
    """Oracle: the clock, the options given, and sizes that the options state."""
    before = datetime.now().astimezone().replace(microsecond=0)
    config = replace(CONFIG, coarse_factor=2.0, coarse_until=0.5)
    result = train(config, data_of(capture), tmp_path / "run")
    trained_at = datetime.fromisoformat(result.metrics["trained_at"])
    assert before <= trained_at <= datetime.now().astimezone()
    factors = {row["step"]: row["photo_factor"] for row in result.metrics["history"]}
    assert factors[1] == 2.0 and factors[20] == factors[40] == 1.0
    assert list(factors.values()) == sorted(factors.values(), reverse=True)
    page = (tmp_path / "run/report.html").read_text(encoding="utf-8")
    assert "Dashed lines: photos became larger" in page and "full size" in page
    for words in (f"{trained_at:%Y-%m-%d %H:%M}", "--iterations 40", "--hold-out 4"):
        assert words in page


def test_a_run_takes_as_many_steps_as_its_photos_are_good_for(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the product of photos and steps per photo; the files record it, so that a resume has
    no steps left, more steps can be requested, and none are undone."""
    monkeypatch.setattr(caps, "_FEWEST_STEPS", 10)
    config, data, out = replace(CONFIG, steps_a_photo=2), data_of(capture), tmp_path / "run"
    events: list[Event] = []
    result = train(config, data, out, events.append)
    (started,) = [event for event in events if isinstance(event, Started)]
    steps = 2 * started.train_views
    assert 10 < result.steps == started.iterations == steps < 40
    assert started.decision("enough").startswith(f"{steps} of 40 steps are taken")
    assert (result.reason, load_config(out / "config.json")[1].iterations) == ("finished", steps)
    stored = load_config(out / "config.json")[1]
    assert train(stored, data, out, resume=True).ended_before
    longer = train(replace(stored, iterations=steps + 2, steps_a_photo=0), data, out, resume=True)
    assert longer.steps == steps + 2
    lower = replace(CONFIG, iterations=40, steps_a_photo=1)
    assert train(lower, data, out, resume=True).steps == longer.steps
    assert load_config(out / "config.json")[1].iterations == longer.steps


def test_points_above_the_limit_are_a_decision(capture: Path, tmp_path: Path) -> None:
    """Oracle: the limit and the number of the capture's points; none below the limit."""
    data, said = data_of(capture), []
    count = len(load_dataset(data).scene.points)
    for most in (count - 3, count):
        events: list[Event] = []
        config = replace(CONFIG, iterations=1, max_splats=most, splats_a_photo=0)
        train(config, data, tmp_path / str(most), events.append)
        (started,) = [event for event in events if isinstance(event, Started)]
        said.append([one.text for one in started.decisions if one.topic == "points"])
    assert said[0][0].startswith(f"{count - 3} of {count} points give splats")
    assert said[1] == []


def test_decisions_are_one_list_everywhere(capture: Path, tmp_path: Path) -> None:
    """Oracle: the list of the first event, in the order of the topics; the same in the terminal,
    metrics.json, the report, the checkpoint and the event of the resumed run."""
    config = replace(CONFIG, iterations=4, splats_a_photo=1, max_splats=10**6)
    config = replace(config, exposure=Switch.AUTO, refine_poses=Switch.AUTO, stereo=Stereo.AUTO)
    data, out, events = data_of(capture), tmp_path / "run", list[Event]()
    result = train(config, data, out, events.append)
    (started,) = [event for event in events if isinstance(event, Started)]
    texts = {one.topic: one.text for one in started.decisions}
    assert {"enough", "stereo", "exposure", "poses"} <= set(texts) and all(texts.values())
    assert list(texts) == [topic for topic in TOPICS if topic in texts]
    assert result.metrics["decided"] == list(texts.values())
    assert result.metrics["decisions"] == [asdict(one) for one in started.decisions]
    page = (out / "report.html").read_text(encoding="utf-8")
    (section,) = re.findall('<section class="decisions">.*?</section>', page)
    assert re.findall("<b>(.*?):</b>", section) == [one.label for one in started.decisions]
    assert load(RunFolder(out).checkpoint(4)).session["decided"] == texts
    assert list(_texts(started))[2:] == list(texts.values())
    again: list[Event] = []
    stored = replace(load_config(out / "config.json")[1], iterations=6)
    train(stored, data, out, again.append, resume=True)
    (resumed,) = [event for event in again if isinstance(event, Started)]
    assert resumed.decisions == started.decisions and resumed.step == 4


def test_a_run_tells_everything_in_order_and_leaves_all_files(
    capture: Path, tmp_path: Path
) -> None:
    """Oracle: the events' contract; files read back by the readers of their formats."""
    config = replace(
        CONFIG,
        test_iterations=(10,),
        save_iterations=(20,),
        checkpoint_iterations=(15,),
        snapshot_every=10,
        preview_seconds=1e-6,
    )
    events: list[Event] = []
    result = train(config, data_of(capture), tmp_path, events.append)
    kinds = [type(e) for e in events]
    # A busy machine is slow enough to report that it reads photos.
    early = events[: kinds.index(Started)]
    assert all(e.step == 0 for e in early if isinstance(e, Progress))
    assert Progress in kinds[kinds.index(Started) :]
    assert kinds[-1] is Done
    assert kinds.count(Started) == kinds.count(Done) == 1
    started, done = events[kinds.index(Started)], events[-1]
    assert isinstance(started, Started)
    assert (started.step, started.train_views, started.test_views) == (0, 6, 2)
    assert (started.width, started.height, started.splats) == (48, 48, 150)
    steps = [e.step for e in events if isinstance(e, Progress)]
    assert steps == sorted(steps)
    assert steps[-1] == 40
    assert [e.step for e in events if isinstance(e, Eval)] == [10, 40]
    assert [from_line(to_line(e)) for e in events] == [from_line(to_line(e)) for e in events]
    for event in events:
        assert from_line(to_line(event)).kind == event.kind
        if isinstance(event, Saved | Preview):
            assert Path(event.path).is_file() or "checkpoints" in event.path

    assert isinstance(done, Done)
    assert done.reason == result.reason == "finished"
    splats = read_ply(tmp_path / "point_cloud.ply")
    assert len(splats) == done.splats == len(result.splats)
    assert splats.sh_degree == 1
    assert len(read_ply(tmp_path / "point_cloud/iteration_20/point_cloud.ply")) >= 150
    assert len(list((tmp_path / "snapshots").iterdir())) == 2
    assert read_image(next((tmp_path / "previews").iterdir())).shape == (48, 48, 3)
    assert len(read_cameras_json(tmp_path / "cameras.json")) == 8
    assert load_config(tmp_path / "config.json") == (data_of(capture), config)
    checkpoints = [p.name for p in RunFolder(tmp_path).checkpoints()]
    assert checkpoints == ["step_00000015.safetensors", "step_00000040.safetensors"]
    assert "white_background=False" in (tmp_path / "cfg_args").read_text()
    assert "<html" in (tmp_path / "report.html").read_text()

    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert read_metrics(tmp_path) == metrics and metrics_problem(tmp_path) == ""
    assert metrics["split"] == "test"
    assert metrics["psnr"] == result.metrics["psnr"] == done.metrics["psnr"]
    assert all(0 <= view["coverage"] <= 1 for view in metrics["views"])
    assert metrics["worst_view"] == done.metrics["worst_view"]
    assert metrics.get("trust_lowest") == done.metrics.get("trust_lowest")
    assert metrics["train_seconds"] == pytest.approx(done.train_seconds)
    assert [entry["step"] for entry in metrics["evals"]] == [10, 40]
    assert [entry["step"] for entry in metrics["history"]] == list(range(1, 41))
    assert "history" not in done.metrics
    assert not list(tmp_path.glob(".*")), "lock and temporary files are gone"


def test_without_held_out_views_training_views_are_measured(capture: Path, tmp_path: Path) -> None:
    """Oracle: the split is named."""
    result = train(CONFIG, DataConfig(source=capture), tmp_path)
    assert result.metrics["split"] == "train"
    assert len(result.metrics["views"]) == 8
    assert result.metrics["psnr"] > 10
    assert result.metrics["lpips_reason"]


def test_a_run_in_two_parts_gives_the_same_file(capture: Path, tmp_path: Path) -> None:
    """Oracle: the bytes of point_cloud.ply of an uninterrupted run."""
    train(CONFIG, data_of(capture), tmp_path / "whole")
    control, seen = Control(), []

    def stop_at_17(event: Event) -> None:
        seen.append(event)
        if isinstance(event, Snapshot):
            control.stop()

    part = replace(CONFIG, snapshot_every=17)
    first = train(part, data_of(capture), tmp_path / "parts", stop_at_17, control)
    assert (first.reason, first.steps) == ("stopped", 17)
    assert isinstance(seen[-1], Done)
    assert seen[-1].reason == "stopped"
    assert first.metrics["psnr"] is None
    assert "stopped" in first.metrics["psnr_reason"]
    events: list[Event] = []
    second = train(CONFIG, data_of(capture), tmp_path / "parts", events.append, resume=True)
    assert isinstance(events[0], Started)
    assert events[0].step == 17
    assert second.train_seconds > first.train_seconds
    whole, parts = (tmp_path / n / "point_cloud.ply" for n in ("whole", "parts"))
    assert whole.read_bytes() == parts.read_bytes()
    degrees = [result.metrics["sh_degree"] for result in (first, second)]
    assert degrees == [0, 1], "those of the files; the second comes into use after step 20"
    steps = [entry["step"] for entry in second.metrics["history"]]
    checkpoint = checkpoints_in(tmp_path / "parts")[40]
    rows = second.metrics["history"]
    wanted = [(entry["step"], entry["loss"], entry["psnr"]) for entry in rows]
    assert read_course(checkpoint) == wanted
    assert steps == list(range(1, 41))


@pytest.mark.parametrize(("measured", "depth"), [("transients", 0), ("blurs", 2)])
def test_a_comparison_of_photos_can_be_paused_and_stopped(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, measured: str, depth: int
) -> None:
    """Oracle: the bytes of point_cloud.ply of an uninterrupted run; its time counts."""
    monkeypatch.setattr("gscore.engine.opening.CpuEngine", lambda **_: FakeEngine(depth))
    for module in (photo_blurs, transients):
        monkeypatch.setattr(module, "_FEWEST", 2)
    monkeypatch.setattr(progress_meter, "_EVENTS_PER_SECOND", 1e9)
    data, control, phases, seconds = data_of(capture), Control(), [], []
    photos = len(load_dataset(data).train)
    last = 3 if measured == "transients" else photos + 1

    def watch(event: Event) -> None:
        if isinstance(event, Snapshot):
            phases.append("snapshot")
        elif isinstance(event, Progress) and event.phase == "paused":
            phases.append("paused")
            control.resume()
        elif isinstance(event, Progress) and event.phase == "comparing photos":
            phases.append("compared")
            seconds.append(event.elapsed_s)
            requests = {1: control.snapshot, 2: control.pause, last: control.stop}
            requests.get(phases.count("compared"), lambda: None)()

    first = train(CONFIG, data, tmp_path / "parts", watch, control)
    due = CONFIG.iterations // 5
    assert (first.reason, first.steps) == ("stopped", due)
    assert phases[:5] == ["compared", "snapshot", "compared", "paused", "compared"]
    assert len(seconds) == last and all(a < b for a, b in itertools.pairwise(seconds))
    names = load(RunFolder(tmp_path / "parts").checkpoint(due)).tensors
    assert ("transient/step" in names) == (measured == "blurs")
    assert train(CONFIG, data, tmp_path / "parts", resume=True).reason == "finished"
    train(CONFIG, data, tmp_path / "whole")
    one, other = ((tmp_path / run / "point_cloud.ply").read_bytes() for run in ("parts", "whole"))
    assert one == other


def test_a_run_killed_before_its_report_writes_it_later(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the files. A process may end after any of them; without the last one, metrics.json, a
    run has not ended."""

    class Killed(BaseException):
        pass

    def killed(*_: Any) -> None:
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(report_page, "write_html", killed)
        with pytest.raises(Killed):
            train(CONFIG, data_of(capture), tmp_path)
    assert (tmp_path / "point_cloud.ply").is_file()
    again = train(CONFIG, data_of(capture), tmp_path, resume=True)
    assert not again.ended_before
    assert (tmp_path / "report.html").is_file() and (tmp_path / "metrics.json").is_file()
    assert train(CONFIG, data_of(capture), tmp_path, resume=True).ended_before


def test_start_checkpoint_goes_on_in_another_folder(capture: Path, tmp_path: Path) -> None:
    """Oracle: 10 more steps; the first folder is unchanged."""
    train(CONFIG, data_of(capture), tmp_path / "a")
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "a").rglob("*")}
    result = train(
        replace(CONFIG, iterations=50),
        data_of(capture),
        tmp_path / "b",
        start_checkpoint=RunFolder(tmp_path / "a").checkpoints()[-1],
    )
    assert result.steps == 50
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "a").rglob("*")} == before


def in_thread(work: Callable[[], Any]) -> tuple[threading.Thread, list[Any]]:
    results: list[Any] = []
    thread = threading.Thread(target=lambda: results.append(work()))
    thread.start()
    return thread, results


def test_pause_snapshot_resume_stop(capture: Path, tmp_path: Path) -> None:
    """Oracle: no step during the pause; a stop works during a pause."""
    control, events = Control(), []
    config = replace(CONFIG, iterations=1_000_000)
    work = lambda: train(config, data_of(capture), tmp_path, events.append, control)  # noqa: E731
    thread, results = in_thread(work)

    def steps() -> list[int]:
        return [e.step for e in list(events) if isinstance(e, Progress)]

    def phases() -> list[str]:
        return [e.phase for e in list(events) if isinstance(e, Progress)]

    end = time.monotonic() + 120
    while not steps() and time.monotonic() < end:
        time.sleep(0.01)
    control.submit("snapshot")
    control.submit("dance")
    control.pause()
    while "paused" not in phases() and time.monotonic() < end:
        time.sleep(0.01)
    held = len(steps())
    time.sleep(0.5)
    assert len(steps()) == held, "no progress while paused"
    shots = sum(isinstance(e, Snapshot) for e in events)
    control.submit("snapshot")
    while sum(isinstance(e, Snapshot) for e in list(events)) == shots and time.monotonic() < end:
        time.sleep(0.01)
    assert sum(isinstance(e, Snapshot) for e in events) == shots + 1, "a snapshot while paused"
    held = len(steps())
    control.resume()
    while len(steps()) < held + 2 and time.monotonic() < end:
        time.sleep(0.01)
    control.pause()
    time.sleep(0.1)
    control.submit("snapshot")
    control.stop("stopped")
    thread.join(60)
    assert sum(isinstance(e, Snapshot) for e in events) == shots + 2, "a snapshot before the end"
    assert results[0].reason == "stopped"
    assert any(isinstance(e, Snapshot) for e in events)
    assert any(isinstance(e, Warn) and "dance" in e.message for e in events)
    assert RunFolder(tmp_path).checkpoints()


def test_stop_before_the_first_step_leaves_nothing(capture: Path, tmp_path: Path) -> None:
    """Oracle: no folder."""
    control = Control()
    control.stop()
    with pytest.raises(Cancelled):
        train(CONFIG, data_of(capture), tmp_path / "out", control=control)
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("real_engine")
def test_bad_input_leaves_the_other_run_alone(capture: Path, tmp_path: Path) -> None:
    """Oracle: every file of the existing run, after each kind of failure."""
    train(CONFIG, data_of(capture), tmp_path)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    nowhere = DataConfig(source=capture / "nothing")
    with pytest.raises(DatasetError):
        train(CONFIG, nowhere, tmp_path, overwrite=True)
    with pytest.raises(ConfigError, match="contains another run"):
        train(CONFIG, data_of(capture), tmp_path)
    with pytest.raises(ConfigError, match="sh_degree was 1, is 2"):
        train(replace(CONFIG, sh_degree=2), data_of(capture), tmp_path, resume=True)
    with pytest.raises(ConfigError, match="LPIPS"):
        bad = replace(CONFIG, lpips=capture / "no.onnx")
        train(bad, data_of(capture), tmp_path, overwrite=True)
    aside = tmp_path.parent / f"{tmp_path.name}-aside.ply"
    splats = read_ply(tmp_path / "point_cloud.ply")
    write_splats(aside, replace(splats, means=splats.means + np.float32(1e5)))
    with pytest.raises(DatasetError, match="None of the"):
        train(replace(CONFIG, start_splats=aside), data_of(capture), tmp_path, overwrite=True)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
    train(CONFIG, data_of(capture), tmp_path, overwrite=True)


def test_too_little_memory_is_reported_before_the_start(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: 10 million splats, too many for 2 GB; the proposed number fits."""
    monkeypatch.setattr(forecast, "available_memory_bytes", lambda: 2_000_000_000)
    config = replace(CONFIG, max_splats=10_000_000, sh_degree=3)
    with pytest.raises(GsError, match=r"use `--max-splats \d+`") as error:
        train(config, data_of(capture), tmp_path / "out")
    assert not (tmp_path / "out").exists()
    offered = int(str(error.value).partition("`--max-splats ")[2].partition("`")[0])
    assert offered > 100_000
    found = estimate(replace(config, max_splats=offered), [(48, 48)] * 8, points=150, pace=1.0)
    assert found.fits


@pytest.mark.usefixtures("real_engine")
def test_running_out_of_memory_is_one_sentence(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: a real failure of a torch allocation in the fifth step."""
    real = CpuEngine.step

    def step(self: CpuEngine, model: Any, request: StepRequest) -> Any:
        if request.step == 5:
            torch.empty(1 << 60)
        return real(self, model, request)

    monkeypatch.setattr(CpuEngine, "step", step)
    with pytest.raises(BackendError, match="Out of memory; use fewer splats"):
        train(CONFIG, data_of(capture), tmp_path)


@pytest.mark.usefixtures("real_engine")
def test_a_capture_far_from_its_origin_is_trained_and_warned_about(
    make_photos: Callable[..., Any],
) -> None:
    """Oracle: the first pictures of the same capture at the origin."""
    near, far = make_photos(), make_photos()
    cameras, cloud = far.scene.cameras, far.scene.points
    offset = np.array([1e6, -2e6, 3e6])
    cameras.viewmats[:, :3, 3] -= np.einsum("cij,j->ci", cameras.viewmats[:, :3, :3], offset)
    np.add(cloud.points, offset, out=cloud.points)
    pictures = [
        Trainer(CONFIG, Analysis(photos=p)).renderer.picture(0, background=(0, 0, 0))
        for p in (near, far)
    ]
    assert pictures[0].mean() > 0.1
    np.testing.assert_allclose(*pictures, atol=1e-4)
