"""gscore refit: splats for a viewer, from a run. Oracle: the run's own files and pictures."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gscore.control import Control
from gscore.formats import read_splat_file
from gscore.viewers import refit as refit_module
from gscore.viewers.rules import VIEWERS

SAME = ("means", "quats")
CHANGED = ("scales", "opacities", "sh0")


@pytest.mark.parametrize("viewer", ["blender", "spark"])
def test_a_refit_reduces_the_error_in_the_viewer(gscore, run_folder, splats, viewer):
    """Oracle: the difference to gscore's own picture before, in the float64 model of the viewer;
    positions, rotations and the result of the training are unchanged."""
    # Spark draws splats of pixels as gscore does, smaller ones fainter.
    small = replace(splats, scales=splats.scales - 1.2)
    run = run_folder(splats if viewer == "blender" else small)
    before = (run / "point_cloud.ply").read_bytes()
    code, out, err = gscore(
        *("refit", run, "--for-viewer", viewer, "--iterations", 60, "--json", "--threads", 1)
    )
    assert code == 0, err
    facts = json.loads(out.splitlines()[-1])
    found = facts["viewers"][viewer]
    assert found["after"]["difference"] < 0.5 * found["before"]["difference"]
    assert facts["views"] == ["a_0.png", "a_8.png"]
    if viewer == "blender":
        assert found["after"]["psnr"] > found["before"]["psnr"] + 3 and facts["own"]["psnr"] > 55
    assert (run / "point_cloud.ply").read_bytes() == before
    written = read_splat_file(facts["path"])
    given = read_splat_file(run / "point_cloud.ply")
    assert written.path == run / f"refit_{viewer}.ply" and not written.antialiased
    assert f"Made by gscore refit for {viewer}" in written.comments
    for name in SAME:
        np.testing.assert_array_equal(getattr(written.splats, name), getattr(given.splats, name))
    for name in CHANGED:
        assert (getattr(written.splats, name) != getattr(given.splats, name)).any()


def test_the_report_has_every_viewer(gscore, run_folder):
    """Oracle: the table of viewers; a refit for one is measured in each, or in none."""
    run = run_folder()
    options = ("--iterations", 1, "--for-viewer", "unity", "--threads", 1)
    code, out, _ = gscore("refit", run, *options, "--all-viewers", "--views", 1)
    text = " ".join(out.split())
    assert code == 0 and "1 test view," in text
    for rules in VIEWERS.values():
        assert rules.label in text
    code, out, _ = gscore("refit", run, *options, "--views", 0, "--json")
    assert code == 0 and "viewers" not in json.loads(out.splitlines()[-1])


def test_events_of_a_refit(gscore, run_folder):
    """Oracle: the kinds of the events, and the path of the last one."""
    run = run_folder()
    options = ("--iterations", 2, "--for-viewer", "unreal", "--threads", 1)
    code, out, _ = gscore("refit", run, *options, "--events", "jsonl", "--views", 1)
    events = [json.loads(line) for line in out.splitlines()]
    phases = [(e["phase"], e["done"]) for e in events if e["event"] == "refit_progress"]
    assert code == 0 and phases[0] == ("reading", 0)
    assert ("fitting", 2) in phases and phases[-1] == ("measuring", 2)
    assert events[-1]["event"] == "refit"
    assert events[-1]["path"] == str(run / "refit_unreal.ply")


def test_a_stopped_refit_keeps_the_old_file(gscore, run_folder, monkeypatch):
    """Oracle: the bytes of the earlier output; exit code 3 and a sentence."""
    run = run_folder()
    options = ("--iterations", 3, "--for-viewer", "spark", "--views", 0, "--threads", 1)
    assert gscore("refit", run, *options)[0] == 0
    first = (run / "refit_spark.ply").read_bytes()
    monkeypatch.setattr(Control, "stopping", True)
    code, _, err = gscore("refit", run, *options)
    assert code == 3 and "nothing was written" in err
    assert (run / "refit_spark.ply").read_bytes() == first
    assert sorted(p.name for p in run.glob("*refit*")) == ["refit_spark.ply"]


def test_bad_input_is_a_sentence(gscore, run_folder, tmp_path):
    """Oracle: one line on stderr with what to do, exit code 2, and no file."""
    run = run_folder()
    foreign = tmp_path / "foreign.ply"
    foreign.write_text("ply\n")
    for options, sentence in (
        (["--for-viewer", "sibr"], "no viewer 'sibr'; give one of blender"),
        (["--for-viewer", "spark", "--iterations", "0"], "must be at least 1, got 0"),
        (["--for-viewer", "spark", "--views", "-1"], "must be at least 0, got -1"),
        (["--for-viewer", "spark", "-o", run / "point_cloud.ply"], "result of the training"),
        (["--for-viewer", "spark", "-o", tmp_path / "a.txt"], "a.txt"),
        (["--for-viewer", "spark", "-o", foreign], "foreign.ply exists already"),
        (["--for-viewer", "spark", "-s", tmp_path / "none"], "none"),
        ([], "--for-viewer"),
    ):
        code, _, err = gscore("refit", run, *options, "--quiet")
        assert code == 2 and sentence in " ".join(err.split()), (options, err)
        assert "Traceback" not in err
    bare = tmp_path / "bare.ply"
    bare.write_bytes((run / "point_cloud.ply").read_bytes())
    code, _, err = gscore("refit", bare, "--for-viewer", "spark", "--quiet")
    assert code == 2 and "give it with -s SOURCE" in " ".join(err.split())
    assert not list(run.glob("refit_*")) and foreign.read_text() == "ply\n"


def test_steps_are_repeatable(gscore, run_folder):
    """Oracle: the bytes of a second refit."""
    run = run_folder()
    options = ("--iterations", 5, "--for-viewer", "supersplat", "--views", 0, "--threads", 1)
    assert gscore("refit", run, *options)[0] == 0
    first = (run / "refit_supersplat.ply").read_bytes()
    assert gscore("refit", run, *options)[0] == 0
    assert (run / "refit_supersplat.ply").read_bytes() == first
    assert set(refit_module.RATES) == {"scales", "opacities", "sh0", "shN"}
