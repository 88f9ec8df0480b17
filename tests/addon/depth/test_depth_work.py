"""Oracle: events of a scripted `gscore depth`, files of the real one, and a clock."""

import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import bpy
import pytest

from addon import preferences
from addon.capture import depth_maps
from addon.core import read_colmap, write_colmap
from addon.depth import predict_depth
from addon.panels import depth
from addon.process import poll_timer
from addon.training import facts, lookups, verb_job
from addon.training.verb_jobs import JOBS
from tests.addon.captures import STUDIO
from tests.addon.trainings import until
from tests.lines_run import lines_run

ROOT = Path(__file__).parents[3]
REAL = os.environ.get("GSCORE_TRAINER_PYTHON", "")
needs_trainer = pytest.mark.skipif(not REAL, reason="GSCORE_TRAINER_PYTHON names no Python")
ROW = {"map": "x.png", "points": 50, "scale": 2.0, "offset": 0.5, "inliers": 0.75, "error": 0.01}
ACCEPTED = ROW | {"view": "view_000.jpg", "accepted": True, "reason": ""}
REFUSED = ROW | {"view": "view_001.jpg", "accepted": False, "reason": "its scale is negative"}
DONE = {
    "event": "depth",
    "views": 2,
    "accepted": 1,
    "predicted": 2,
    "kept": 0,
    "folder": "f",
    "params": "p",
    "sheet": "s",
    "table": [REFUSED, ACCEPTED],
    "why": "Depth supervises 2 training views.",
}


def progress(done: int, phase: str = "predicting") -> dict:
    """A step of a script."""
    event = {"event": "depth_progress", "done": done, "total": 4, "view": "v", "eta_s": 3.0}
    return {"say": event | {"phase": phase}}


@pytest.fixture
def play(tmp_path: Path, play: Callable[..., Path]) -> Callable[..., Path]:
    """Like `play` of all tests, with a network."""

    def choose(*script: dict) -> Path:
        network = tmp_path / "net.onnx"
        network.write_bytes(b"x")
        preferences.get().depth_model = str(network)
        return play(*script)

    return choose


def test_a_prediction_from_click_to_table(studio: bpy.types.Scene, play) -> None:
    """Oracle: the events of the script, and Blender's own list of rows."""
    result = DONE | {"why": "Not used; `--depth-mode on` uses it."}
    called = play(progress(0, "reading"), progress(1), {"await": "go"}, {"say": result})
    assert bpy.ops.gscore.predict_depth() == {"FINISHED"}
    job = predict_depth.job_of(studio)
    until(lambda: job.progress is not None and job.progress.done == 1)
    assert (job.share, job.ended, studio.gscore.depth_shown) == (0.25, False, "MAPS")
    with pytest.raises(RuntimeError, match="is running already"):
        bpy.ops.gscore.check_depth()
    job._process.send("go")
    until(lambda: job.ended)
    assert job.status == verb_job.FINISHED
    assert job.sentence == "2 maps predicted. 1 of 2 maps are accepted."
    report = predict_depth.report(studio)
    assert report is job.report
    assert [row.view for row in report.rows] == ["view_000.jpg", "view_001.jpg"]
    assert report.why == 'Not used; "Use Depth: Always" uses it.'
    table = depth.table_of(bpy.context)
    assert [(i.name, i.verdict) for i in table.views] == [
        ("view_000.jpg", "accepted"),
        ("view_001.jpg", "refused"),
    ]
    assert table.active == 1  # the first that is refused
    words = called.read_text()
    assert "depth" in words and "--model" in words and "net.onnx" in words
    assert "--overwrite" not in words and "jsonl" in words


def test_checking_writes_nothing_and_follows_the_settings(studio: bpy.types.Scene, play) -> None:
    """Oracle: the command line."""
    called = play({"say": DONE})
    studio.gscore.use_masks = False
    assert bpy.ops.gscore.check_depth(wait=True) == {"FINISHED"}
    words = called.read_text()
    assert "--check" in words and "--model" not in words
    assert "--mask-mode" in words and "none" in words


def test_cancelling_asks_and_then_ends(
    studio: bpy.types.Scene, play, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: a script that ends on request, and one that never does."""
    stopped = {"event": "error", "message": "Stopped after 1 views.", "type": "Cancelled"}
    play(progress(1), {"await": "stop"}, {"say": stopped})
    job = predict_depth.predict(studio)
    until(lambda: job.progress is not None)
    assert bpy.ops.gscore.cancel_depth() == {"FINISHED"}
    until(lambda: job.ended)
    assert (job.status, job.report) == (verb_job.CANCELLED, None)
    with pytest.raises(RuntimeError, match="No depth job is running"):
        bpy.ops.gscore.cancel_depth()
    monkeypatch.setattr(verb_job, "STOP_GRACE", 0.2)
    play(progress(1), {"sleep": 600})
    job = predict_depth.predict(studio)
    until(lambda: job.progress is not None)
    job.cancel()
    until(lambda: job.ended, timeout=60)
    assert job.status == verb_job.CANCELLED


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ([{"say": {"event": "error", "message": "no ONNX model.", "type": "x"}}], "No ONNX model."),
        ([{"signal": 9}], "signal 9"),
        ([{"stderr": "kaputt"}, {"exit": 3}], "kaputt"),
        ([{"say": DONE | {"table": [{"view": "x"}]}}], "unexpected entry"),
    ],
)
def test_failures_are_reported(studio: bpy.types.Scene, play, script: list, words: str) -> None:
    """Oracle: an error message; earlier results are still shown."""
    play(*script)
    before = predict_depth.report(studio)
    with pytest.raises(RuntimeError, match=words):
        bpy.ops.gscore.predict_depth(wait=True)
    assert predict_depth.job_of(studio).status == verb_job.FAILED
    assert predict_depth.report(studio) == before


def test_missing_inputs_are_reported_before_the_start(
    studio: bpy.types.Scene, play, tmp_path: Path
) -> None:
    """Oracle: error messages; no job."""
    play()
    with pytest.raises(RuntimeError, match="no depth network"):
        bpy.ops.gscore.predict_depth(filepath=str(tmp_path / "none.onnx"))
    preferences.get().depth_model = ""
    with pytest.raises(RuntimeError, match="Depth Network is empty"):
        bpy.ops.gscore.predict_depth()
    preferences.get().python_path = str(tmp_path / "no-python")
    with pytest.raises(RuntimeError, match=r"no-python"):
        bpy.ops.gscore.check_depth()
    studio.gscore.capture_path = ""
    with pytest.raises(RuntimeError, match="Capture is empty"):
        bpy.ops.gscore.check_depth()
    assert JOBS.jobs() == []


def test_the_training_has_a_report_of_its_own(studio: bpy.types.Scene, tmp_path: Path) -> None:
    """Oracle: metrics.json; the settings choose between it and the current maps."""
    maps = predict_depth.report(studio)
    assert len(maps.rows) == 60
    content = {"depth": {"why": "Few views.", "views": [ACCEPTED | {"split": "train"}]}}
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "metrics.json").write_text(json.dumps(content))
    lookups.depth_runs.expire()
    until(lambda: set(predict_depth.reports(studio)) == {"MAPS", "RUN"})
    assert predict_depth.report(studio).why == "Few views."
    assert predict_depth.report(studio).rows[0].split == "train"
    studio.gscore.depth_shown = "MAPS"
    assert predict_depth.report(studio) is maps
    (tmp_path / "out" / "metrics.json").write_text("{")
    lookups.depth_runs.expire()
    until(lambda: "metrics.json" in predict_depth.run_report(studio)[1])
    assert predict_depth.report(studio) is maps


def test_a_beat_with_a_thousand_views_is_short(studio: bpy.types.Scene, play) -> None:
    """Oracle: the count of lines per view; the table is complete immediately."""
    table = [ACCEPTED | {"view": f"v{i:04}.jpg"} for i in range(1000)]
    play({"say": DONE | {"table": table}})
    job = predict_depth.check(studio)
    longest, end = 0, time.monotonic() + 60
    while depth.table_of(bpy.context) is None or not job.ended:
        assert time.monotonic() < end
        longest = max(longest, lines_run(poll_timer.poll))
        time.sleep(0.01)
    poll_timer.poll()
    assert len(depth.table_of(bpy.context).views) == 1000
    assert longest < 100 * len(table)


@needs_trainer
def test_the_real_thing(scene: bpy.types.Scene, tmp_path: Path, no_work: None) -> None:
    """Oracle: files of the real `gscore depth` with a network that is affine in grey."""
    capture, model = tmp_path / "cap", tmp_path / "net.onnx"
    whole = read_colmap(STUDIO)
    few = replace(whole, images=sorted(whole.images, key=lambda image: image.name)[::6])
    write_colmap(few, capture / "sparse" / "0")
    (capture / "images").mkdir()
    for image in few.images:
        shutil.copy(STUDIO / "images" / image.name, capture / "images")
    code = "import pathlib, sys; from tests.depth.conftest import midas; "
    code += "midas(pathlib.Path(sys.argv[1]))"
    subprocess.run([REAL, "-c", code, str(model)], cwd=ROOT, check=True, timeout=120)
    scene.gscore.capture_path = str(capture)
    scene.gscore.output_path = str(tmp_path / "out")
    assert facts.refresh(scene)[0].depths == 0 and predict_depth.report(scene) is None
    preferences.get().python_path = REAL
    job = predict_depth.predict(scene, model, wait=True)
    assert job.status == verb_job.FINISHED, job.sentence
    assert len(list((capture / "depths").glob("*.png"))) == 10 + 1  # the contact sheet
    params = json.loads((capture / "sparse" / "0" / "depth_params.json").read_text())
    rows = predict_depth.report(scene).rows
    assert len(rows) == 10
    for row in rows:
        entry = params[row.name]
        assert (row.verdict == depth_maps.ACCEPTED) == entry["accepted"]
        assert row.points == entry["points"]
    before = {path: path.stat().st_mtime_ns for path in capture.rglob("*")}
    checked = predict_depth.check(scene, wait=True)
    assert checked.status == verb_job.FINISHED, checked.sentence
    assert {path: path.stat().st_mtime_ns for path in capture.rglob("*")} == before
    assert [r.verdict for r in predict_depth.report(scene).rows] == [r.verdict for r in rows]
    until(lambda: facts.capture(scene)[0].depths == 10)
    assert bpy.ops.gscore.show_depth_sheet() == {"FINISHED"}
    assert bpy.data.images["contact_sheet.png"].size[0] > 500
    JOBS._jobs.clear()
