"""gscore compare: against both metrics.json, and its refusals."""

import base64
import io
import json
import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscore.config_file import config_json, load_config
from gscore.io.ply.splats import write_splats


@pytest.fixture
def two_runs(gscore, run_folder, splats, tmp_path):
    """The run with the splats that the photos were rendered from, and one with fewer of them,
    measured."""
    first = run_folder()
    second = tmp_path / "other"
    shutil.copytree(first, second)
    write_splats(second / "point_cloud.ply", splats.subset(np.arange(40)))
    for folder in (first, second):
        assert gscore("eval", folder, "--quiet")[0] == 0
    return first, second


def test_differences_are_those_of_both_metrics(gscore, two_runs, tmp_path):
    """Oracle: metrics.json of both runs; a page, which may be replaced."""
    page = tmp_path / "c.html"
    for _ in range(2):
        code, text, _ = gscore("compare", *two_runs, "-o", page, "--json")
    facts = json.loads(text)
    metrics = [json.loads((run / "metrics.json").read_text()) for run in two_runs]
    assert code == 0 and facts["runs"] == ["run", "other"]
    assert [v["name"] for v in facts["views"]] == ["a_0.png", "a_8.png"]
    for place in range(2):
        assert facts["means"]["ssim"][place] == pytest.approx(metrics[place]["ssim"])
    for entry, *views in zip(facts["views"], *(m["views"] for m in metrics), strict=True):
        assert entry["psnr"] == [view["psnr"] for view in views]
    assert facts["options"] == {} and facts["only_in"] == [[], []]
    code, text, _ = gscore("compare", *two_runs, "-o", page)
    assert code == 0 and "2 views measured in both run and other" in text


def test_a_run_that_was_stopped_is_named(gscore, two_runs, tmp_path):
    """Oracle: the metrics.json of the second, changed."""
    path = two_runs[1] / "metrics.json"
    stopped = {"reason": "interrupted", "steps": 5}
    path.write_text(json.dumps(json.loads(path.read_text()) | stopped))
    code, _, err = gscore("compare", *two_runs, "-o", tmp_path / "c.html")
    assert code == 0 and "other was stopped after 5 of 12 steps" in " ".join(err.split())
    assert "run was stopped" not in err and "other was stopped" in (tmp_path / "c.html").read_text()


def test_pictures_are_photo_and_both_renders(gscore, two_runs, tmp_path, capture):
    """Oracle: the photo, which equals the first run's render and not the second's."""
    page = tmp_path / "c.html"
    gscore("compare", *two_runs, "-o", page)
    kinds = re.findall(r'<img class="(\w+)" src="data:image/jpeg;base64,([^"]+)"', page.read_text())
    shown = {
        kind: np.asarray(Image.open(io.BytesIO(base64.b64decode(data)))).astype(float)
        for kind, data in kinds[:3]
    }
    photo = np.asarray(Image.open(capture / "images" / "a_0.png")).astype(float)
    far = {kind: np.abs(picture - photo).mean() for kind, picture in shown.items()}
    assert far["photo"] < 4 and far["first"] < 4 < 2 * far["first"] < far["second"]


def test_runs_that_cannot_be_compared(gscore, two_runs, tmp_path, capture):
    """Oracle: exit code 2 and the sentence; no page."""
    first, second = two_runs
    page = tmp_path / "c.html"

    def refused(*words):
        code, _, err = gscore("compare", *words)
        assert code == 2 and not page.exists()
        return " ".join(err.split())

    assert "is given twice" in refused(first, first, "-o", page)
    assert "is not a folder" in refused(first, first / "point_cloud.ply", "-o", page)
    assert "There is no folder" in refused(first, first / "nothing", "-o", page)
    assert "give a name with .html" in refused(first, second, "-o", tmp_path / "c.png")
    data, train = load_config(second / "config.json")
    (second / "config.json").write_text(config_json(replace(data, source=tmp_path / "x"), train))
    assert "give runs on one capture" in refused(first, second, "-o", page)
    assert gscore("compare", first, second, "-o", page, "-s", capture)[0] == 0
    page.unlink()
    (second / "config.json").write_text(config_json(data, train))
    (second / "metrics.json").unlink()
    assert f"gscore eval {second}" in refused(first, second, "-o", page)
    (second / "config.json").unlink()
    assert "contains no config.json" in refused(first, second, "-o", page)


def test_suggested_evaluations_make_runs_comparable(gscore, two_runs, tmp_path, monkeypatch):
    """Oracle: the commands of the sentence, typed: the comparison works, and both runs are
    unchanged."""
    monkeypatch.chdir(tmp_path)  # the folder of compare.html
    first, second = two_runs
    assert gscore("eval", first, "-r", "24", "--quiet")[0] == 0
    kept = [(run / "metrics.json").read_bytes() for run in two_runs]
    code, _, err = gscore("compare", first, second, "-o", tmp_path / "c.html")
    said = " ".join(err.split())
    assert code == 2
    commands = re.findall("gscore (eval .*), and compare that: gscore (compare .*)$", said)
    for command in commands[0]:
        code, text, _ = gscore(*shlex.split(command), "--json")
        assert code == 0
    facts, apart = json.loads(text), Path(shlex.split(commands[0][1])[-1])
    measured = json.loads((apart / "metrics.json").read_text())
    assert apart.parent == second.parent and (tmp_path / "compare.html").is_file()
    wanted = measured.get("psnr_masked", measured["psnr"])
    assert facts["means"]["psnr"][1] == pytest.approx(wanted)
    assert facts["options"] == {}
    assert kept == [(run / "metrics.json").read_bytes() for run in two_runs]


def test_somebody_elses_page_stays(gscore, two_runs, tmp_path):
    """Oracle: the file."""
    page = tmp_path / "c.html"
    page.write_text("mine")
    code, _, err = gscore("compare", *two_runs, "-o", page)
    assert code == 2 and "never have" not in err  # the message about formats without comments
    assert "without a mark of" in err and page.read_text() == "mine"
    assert gscore("compare", *two_runs, "-o", page, "--overwrite")[0] == 0


def test_the_report_of_a_run_stays(gscore, two_runs):
    """Oracle: the file."""
    report = two_runs[0] / "report.html"
    before = report.read_bytes()
    code, _, err = gscore("compare", *two_runs, "-o", report, "--overwrite")
    assert code == 2 and "name of a run's report" in err and report.read_bytes() == before


@pytest.mark.parametrize("value", ["x" * 400, int("9" * 400)])
@pytest.mark.parametrize("key", ["mask_mode", "width", "height"])
def test_long_values_of_metrics_are_not_repeated_whole(gscore, two_runs, tmp_path, key, value):
    """Oracle: the refusal of runs that differ, and its length."""
    path = two_runs[1] / "metrics.json"
    content = json.loads(path.read_text())
    (content if key == "mask_mode" else content["views"][0])[key] = value
    path.write_text(json.dumps(content))
    code, _, err = gscore("compare", *reversed(two_runs), "-o", tmp_path / "c.html")
    assert code == 2 and "was scored" in " ".join(err.split())
    assert str(value)[:21] not in err.replace("\n", "")
