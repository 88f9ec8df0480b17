"""gscore eval: the numbers of a run or a bare PLY, and its files."""

import html
import json
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from gscore.config_file import config_json, load_config
from gscore.io.exposure_json import EXPOSURE_FILE, write_exposures
from gscore.io.metrics_file import read_metrics
from gscore.io.ply.splats import read_ply, write_splats
from gscore.photo_exposure import NEUTRAL, PhotoExposure
from gscore.sh import SH_C0
from gscore.text_format import trust_text
from tests.commands.conftest import STEPS
from tests.light_changes import exposed_bytes


def photo(capture, index):
    return np.asarray(Image.open(capture / "images" / f"a_{index}.png")) / 255.0


def test_a_perfect_run(gscore, run_folder, capture):
    """Oracle: photos that are the run's own renders, so that only rounding to 8 bit is left."""
    folder = run_folder()
    code, out, err = gscore("eval", folder, "--json")
    assert code == 0
    facts = json.loads(out.splitlines()[-1])
    assert 55 < facts["psnr"] < 65  # rounding error of 1/255: 20 log10(255 sqrt(12)) = 58.9 dB
    assert facts["psnr_u8"] is None and "identical" in facts["psnr_u8_reason"]
    assert facts["ssim"] > 0.999 and facts["lpips"] is None and facts["lpips_reason"]
    assert facts["splats"] == 60 and facts["split"] == "test" and facts["sh_degree"] == 1
    assert err == ""  # a log needs no progress lines of short work
    written = json.loads((folder / "metrics.json").read_text())
    assert [v["name"] for v in written["views"]] == ["a_0.png", "a_8.png"]
    assert written["test_views"] == ["a_0.png", "a_8.png"] and len(written["train_views"]) == 7
    page = (folder / "report.html").read_text()
    assert f"{facts['psnr']:.2f}" in page and capture.name in page


def test_color_shift_is_distinguished(gscore, run_folder, splats, monkeypatch):
    """Oracle: a darker model: the splats' colours times 0.8 over black, so the render times 0.8.
    Photos 80 degrees apart cover little of each other's background, so all views count here."""
    monkeypatch.setattr("gscore.metrics.coverage.COVERED", 0.0)
    darker = replace(splats, sh0=splats.sh0 * 0.8 - 0.1 / SH_C0, shN=splats.shN * 0.8)
    folder = run_folder(splats=darker)
    code, out, _ = gscore("eval", folder, "--json")
    facts = json.loads(out.splitlines()[-1])
    assert code == 0 and facts["psnr"] < 35 and facts["psnr_cc"] > 50
    views = json.loads((folder / "metrics.json").read_text())["views"]
    assert facts["psnr_cc"] == pytest.approx(np.mean([v["psnr_cc"] for v in views]))
    _, out, _ = gscore("eval", folder)
    assert f"colour-corrected PSNR {facts['psnr_cc']:.2f} dB" in " ".join(out.split())
    assert facts["not_covered"] == [] and all(view["coverage"] < 0.9 for view in views)
    worst = min((v["psnr_cc"], v["name"]) for v in views)
    assert facts["worst_view"]["psnr_cc"] == {"view": worst[1], "value": worst[0]}
    words = f"Worst view, colour-corrected: PSNR {worst[0]:.2f} dB ({worst[1]})"
    assert words in " ".join(out.split())
    assert words in (folder / "report.html").read_text()


def test_coverage_is_that_of_held_out_views(gscore, run_folder):
    """Oracle: no coverage of views that the training saw."""
    folder = run_folder()
    code, out, _ = gscore("eval", folder, "--split", "all", "-o", folder / "all", "--json")
    assert code == 0 and "worst_view" not in json.loads(out.splitlines()[-1])


def test_trust_is_stated_of_views_between_training_photos(gscore, run_folder):
    """Oracle: the file, whose list `--json` lacks; pairs of training photos alone; the sentence in
    output and report."""
    folder = run_folder()
    code, out, _ = gscore("eval", folder, "--json")
    facts, metrics = json.loads(out.splitlines()[-1]), read_metrics(folder)
    views = metrics["trust"]
    assert code == 0 and views and "trust" not in facts
    assert {name for view in views for name in view["between"]} <= set(metrics["train_views"])
    shares = [view["trust"] for view in views]
    assert facts["trust_median"] == metrics["trust_median"] == pytest.approx(np.median(shares))
    assert facts["trust_lowest"]["trust"] == min(shares)
    _, out, _ = gscore("eval", folder)
    assert trust_text(metrics) in " ".join(out.split())
    assert html.escape(trust_text(metrics)) in (folder / "report.html").read_text()


def test_training_facts_are_kept(gscore, run_folder):
    """Oracle: the metrics.json of the training."""
    folder = run_folder()
    before = json.loads((folder / "metrics.json").read_text())
    gscore("eval", folder)
    written = json.loads((folder / "metrics.json").read_text())
    kept = ("steps", "train_seconds", "peak_memory_bytes", "history", "evals", "reason")
    assert {key: written[key] for key in kept} == {key: before[key] for key in kept}
    assert written["steps"] == STEPS and written["train_seconds"] > 0
    assert before["psnr"] < 50 < written["psnr"]
    assert "stopped" not in (folder / "report.html").read_text()


def test_a_report_tells_again_how_the_run_was_made(gscore, run_folder, capture):
    """Oracle: the end and date in the run's metrics.json, the options in its config.json."""
    folder = run_folder()
    path = folder / "metrics.json"
    left = {"reason": "target", "trained_at": "2031-02-03T04:05:06+00:00"}
    path.write_text(json.dumps(json.loads(path.read_text()) | left))
    assert gscore("eval", folder)[0] == 0
    page = (folder / "report.html").read_text()
    for words in ("2031-02-03 04:05", "to the target PSNR", f"--iterations {STEPS}"):
        assert words in page
    assert f"gscore train {capture} -o {folder} --preset draft" in page
    assert "--overwrite" not in page and "steps-a-photo 0" not in page


def test_stopped_training_is_reported(gscore, run_folder):
    """Oracle: cause and time of its end in its metrics.json, in the output and in the report."""
    folder = run_folder()
    path = folder / "metrics.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"reason": "interrupted"}))
    data, train = load_config(folder / "config.json")
    (folder / "config.json").write_text(config_json(data, replace(train, iterations=3000)))
    for _ in range(2):  # an evaluation keeps the values of the training
        code, _, err = gscore("eval", folder)
        words = f"The training was stopped after {STEPS} of 3,000 steps"
        assert code == 0 and words in " ".join(err.split())
        assert words in (folder / "report.html").read_text()


def test_no_splats_against_the_photo(gscore, run_folder, capture, splats, tmp_path):
    """Oracle: the photo's mean square as MSE, because an empty model shows the background."""
    nothing = splats.subset(np.zeros(60, bool))
    code, out, _ = gscore("eval", run_folder(splats=nothing), "--json", "-o", tmp_path / "e")
    assert code == 0
    facts = json.loads(out)
    views = json.loads((tmp_path / "e" / "metrics.json").read_text())["views"]
    wanted = [-10 * math.log10(np.mean(photo(capture, i) ** 2)) for i in (0, 8)]
    assert [v["psnr"] for v in views] == pytest.approx(wanted, abs=1e-6)
    assert facts["psnr"] == pytest.approx(sum(wanted) / 2, abs=1e-6)


def test_a_bare_ply(gscore, capture, splats, tmp_path):
    """Oracle: a model with colours too bright by a known amount, over all views."""
    ply = tmp_path / "model.ply"
    write_splats(ply, replace(splats, sh0=splats.sh0 + np.float32(0.5)))
    code, out, err = gscore("eval", ply, "-s", capture, "-o", tmp_path / "e", "--json")
    assert code == 0 and "training views of this model are unknown" in err
    assert 15 < json.loads(out)["psnr"] < 35
    for split, count in (("train", 7), ("all", 9)):
        options = ("--split", split, "--quiet")
        code, out, _ = gscore("eval", ply, "-s", capture, "-o", tmp_path / split, *options)
        assert code == 0 and out.startswith(f"{count} ")
        written = json.loads((tmp_path / split / "metrics.json").read_text())
        assert written["split"] == split and len(written["views"]) == count
        assert written["steps"] is None and written["train_seconds"] is None


def test_another_split_and_resolution(gscore, run_folder, tmp_path):
    """Oracle: every third of nine views; half the width."""
    options = ("--test-every", "3", "-r", "2", "-o", tmp_path / "e", "--quiet")
    code, _, _ = gscore("eval", run_folder(), *options)
    views = json.loads((tmp_path / "e" / "metrics.json").read_text())["views"]
    assert code == 0 and [v["name"] for v in views] == ["a_0.png", "a_3.png", "a_6.png"]
    assert all((v["width"], v["height"]) == (24, 18) and v["psnr"] > 25 for v in views)


def test_views_of_the_training_are_not_passed_off_as_test_views(gscore, run_folder, tmp_path):
    """Oracle: the run held out views 0 and 8 of nine."""
    run = run_folder()
    _, _, err = gscore("eval", run, "--hold-out", "4", "-o", tmp_path / "some")
    assert "1 of 3 test views were training photos of this run" in err
    _, _, err = gscore("eval", run, "--hold-out", "last:1", "-o", tmp_path / "none")
    assert "training photos of this run" not in err
    _, _, err = gscore("eval", run, "-o", tmp_path / "own")
    assert "training photos of this run" not in err


def test_photos_of_another_capture_are_named(gscore, capture, run_folder, tmp_path):
    """Oracle: a copy of the capture, which is the run's; then other cameras of the run, and other
    names. Trust is that of training photos, so there is none of others."""
    run = run_folder()
    other = shutil.copytree(capture, tmp_path / "other")
    given = ("eval", run, "-s", other, "--json", "--overwrite", "-o", tmp_path / "e")
    code, out, err = gscore(*given)
    assert code == 0 and "are not those of the run" not in err and "trust_median" in out
    own = (run / "cameras.json").read_text()
    cameras = json.loads(own)
    for camera in cameras:
        camera["position"][0] += 2
    moved, renamed = json.dumps(cameras), own.replace("a_", "b_")
    for written, what in ((moved, "9 have the names of the run's, but"), (renamed, "none of them")):
        (run / "cameras.json").write_text(written)
        code, out, err = gscore(*given)
        said = " ".join(err.split())
        assert code == 0 and "These 9 photos are not those of the run" in said and what in said
        assert "trust_median" not in out
        facts = json.loads((tmp_path / "e" / "metrics.json").read_text())
        assert (facts["split"], facts["train_views"]) == ("all", [])


def test_unknown_exposures_are_reported(gscore, run_folder, tmp_path):
    """Oracle: a run marked as having exposures, with those of some photos in exposure.json."""
    folder = run_folder()
    path = folder / "metrics.json"
    exposure = {"stops_apart": 0.6, "learnt": True, "why": "They differ.", "known_by": None}
    content = json.loads(path.read_text()) | {"exposure": exposure}
    path.write_text(json.dumps(content))
    for names in (content["train_views"], content["train_views"] + content["test_views"]):
        write_exposures(folder / EXPOSURE_FILE, dict.fromkeys(names, NEUTRAL))
        for split, known in (("train", True), ("test", len(names) > len(content["train_views"]))):
            out = ("-o", tmp_path / split, "--quiet", "--overwrite")
            code, _, err = gscore("eval", folder, "--split", split, *out)
            assert code == 0 and ("have the mean exposure" in " ".join(err.split())) is not known


def test_pictures_have_the_exposure_of_their_photo(gscore, run_folder, capture, tmp_path):
    """Oracle: photos that are the run's own renders, darker by known gains."""
    folder, dark, gain = run_folder(), tmp_path / "dark", np.array([0.5, 0.6, 0.7])
    shutil.copytree(capture, dark)
    for path in (dark / "images").iterdir():
        pixels = np.asarray(Image.open(path).convert("RGB"))
        Image.fromarray(exposed_bytes(pixels, gain)).save(path)

    def worst() -> float:
        out = ("-o", tmp_path / "out", "--quiet", "--overwrite")
        assert gscore("eval", folder, "-s", dark, "--split", "all", *out)[0] == 0
        content = json.loads((tmp_path / "out" / "metrics.json").read_text())
        return min(view["psnr"] for view in content["views"])

    assert worst() < 30
    names = [path.name for path in (dark / "images").iterdir()]
    write_exposures(folder / EXPOSURE_FILE, dict.fromkeys(names, PhotoExposure.of(gain)))
    assert worst() > 45
    for bad in ("[[0, 0, 0, 0]]", "[[1, 0, 0, 1e999], [0, 1, 0, 0], [0, 0, 1, 0]]"):
        (folder / EXPOSURE_FILE).write_text(f'{{"a": {bad}}}')
        code, _, err = gscore("eval", folder, "--quiet")
        assert code == 2 and f"{EXPOSURE_FILE} is damaged" in " ".join(err.split())


def test_held_out_views_are_not_replaced_by_others(gscore, run_folder, tmp_path):
    """Oracle: the file of the run, byte for byte; another output receives the measurement."""
    folder = run_folder()
    before = (folder / "metrics.json").read_bytes()
    for split in ("train", "all"):
        code, _, err = gscore("eval", folder, "--split", split, "--quiet")
        assert code == 2 and "-o" in err and "held-out" in err
        assert (folder / "metrics.json").read_bytes() == before
        assert gscore("eval", folder, "--split", split, "-o", tmp_path / split, "--quiet")[0] == 0
        assert read_metrics(tmp_path / split)["split"] == split
    assert gscore("eval", folder, "--quiet")[0] == 0


def test_bad_input(gscore, capture, run_folder, splats, tmp_path):
    """Oracle: exit code 2, one sentence, no files."""
    ply = tmp_path / "model.ply"
    write_splats(ply, splats)
    cases = [
        ((ply, "-s", capture), "with -o"),
        ((ply, "-o", tmp_path / "e"), "is unknown; give it with -s"),
        ((ply, "-s", tmp_path / "no", "-o", tmp_path / "e"), "no"),
        ((ply, "-s", capture, "-o", ply / "e"), "is a file; a folder is needed"),
        ((capture / "images" / "a_0.png", "-s", capture, "-o", tmp_path / "e"), "single photo"),
        ((ply, "-s", capture, "-o", tmp_path / "e", "--lpips", tmp_path / "x.onnx"), "x.onnx"),
    ]
    for arguments, says in cases:
        code, out, err = gscore("eval", *arguments)
        assert code == 2 and out == "" and says in err and "Traceback" not in err
    assert not (tmp_path / "e").exists()
    folder = run_folder()
    (folder / "config.json").write_text("{")
    code, _, err = gscore("eval", folder)
    assert code == 2 and "config.json" in err


def test_a_capture_that_moved(gscore, capture, run_folder, tmp_path):
    """Oracle: the sentence, which names -s; with it, two of nine views are measured, the run's
    split."""
    folder = run_folder()
    config = json.loads((folder / "config.json").read_text())
    config["data"]["source"] = str(tmp_path / "gone")
    (folder / "config.json").write_text(json.dumps(config))
    code, _, err = gscore("eval", folder)
    assert code == 2 and "gone" in err and "give its current folder with -s SOURCE" in err
    code, out, _ = gscore("eval", folder, "-s", capture, "--quiet")
    assert code == 0 and out.startswith("2 test views: PSNR")
    assert f"{folder / 'metrics.json'}, {folder / 'report.html'}" in out


def test_measuring_again_keeps_what_the_training_says_of_itself(gscore, run_folder):
    """Oracle: the values in the previous metrics.json: cause of the end, and depth."""
    folder = run_folder()
    path = folder / "metrics.json"
    own = {"reason": "converged", "depth": {"abs_rel": 0.1}, "steps": STEPS}
    path.write_text(json.dumps(json.loads(path.read_text()) | own))
    assert gscore("eval", folder, "--quiet")[0] == 0
    after = json.loads(path.read_text())
    assert {key: after[key] for key in own} == own and after["psnr"] > 20


def test_minus_one_is_the_size_of_the_photos(gscore, run_folder, tmp_path):
    """Oracle: the photos' 48 px, on a run that was trained at 24; the size of the first measurement
    without the option."""
    folder = run_folder()
    config = json.loads((folder / "config.json").read_text())
    config["data"]["max_width"] = 24
    (folder / "config.json").write_text(json.dumps(config))
    for options, width in (((), 24), (("-r", "-1"), 48), (("--resolution=-1",), 48)):
        code, _, _ = gscore("eval", folder, *options, "-o", tmp_path / "e", "--quiet")
        views = json.loads((tmp_path / "e" / "metrics.json").read_text())["views"]
        assert code == 0 and {view["width"] for view in views} == {width}


def test_foreign_measurements_are_not_replaced(gscore, run_folder, tmp_path, capture):
    """Oracle: unchanged files of others, one sentence each."""
    folder, other = run_folder(), tmp_path / "other"
    shutil.copytree(folder, other)
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    (theirs / "metrics.json").write_text('{"accuracy": 1}')
    files = [p for p in (*other.rglob("*"), *theirs.iterdir()) if p.is_file()]
    before = {p: p.read_bytes() for p in files}
    for place, words in (
        (other, "is the folder of another run"),
        (theirs, f"{theirs / 'metrics.json'} exists already, without a mark"),
        (capture, "is the capture itself"),
        (capture / "images", "is the folder of the photos"),
    ):
        code, _, err = gscore("eval", folder, "-o", place, "--quiet")
        assert code == 2 and words in err and err.count("\n") == 1
    assert {p: p.read_bytes() for p in files} == before


def test_broken_network_of_the_environment_is_reported(gscore, run_folder, tmp_path, monkeypatch):
    """Oracle: the path in GSCORE_LPIPS; no message where it is not set."""
    folder = run_folder()
    assert "LPIPS" not in gscore("eval", folder, "--quiet")[2]
    monkeypatch.setenv("GSCORE_LPIPS", str(tmp_path / "lpips_none.onnx"))
    code, _, err = gscore("eval", folder, "--quiet")
    assert code == 0 and "Warning: LPIPS is not measured, although GSCORE_LPIPS is set" in err
    assert "lpips_none.onnx" in err


def test_reports_show_splats_and_cameras(gscore, trained, run_folder, tmp_path):
    """Oracle: the pages of a training and of an evaluation: three histograms, each camera in two
    plans and the map of trust, the held-out ones with their PSNR."""
    run = run_folder()
    assert gscore("eval", run, "-o", tmp_path / "out")[0] == 0
    for page in (trained / "report.html", tmp_path / "out" / "report.html"):
        text = page.read_text()
        assert text.count('class="bars"') == 3 and "Anisotropy" in text
        assert text.count("<polygon") == 3 * 9
        assert "<title>a_1.png</title>" in text
    assert 'class="wedge scored"' in (trained / "report.html").read_text()


def test_errors_on_the_splats(gscore, run_folder, splats, tmp_path):
    """Oracle: half of the splats in a wrong colour, which are the bright ones; the events."""
    wrong = splats.means[:, 0] > np.median(splats.means[:, 0])
    sh0 = splats.sh0.copy()
    sh0[wrong] = 0.9 / SH_C0
    folder = run_folder(splats=replace(splats, sh0=sh0))
    path = tmp_path / "e" / "errors.ply"
    options = ("--split", "all", "-o", tmp_path / "e", "--error-map", path)
    code, out, _ = gscore("eval", folder, *options, "--events", "jsonl")
    events = [json.loads(line) for line in out.splitlines()]
    assert code == 0 and events[-1]["event"] == "evaluated" and events[-1]["error_bright"] > 0.05
    reported = [event for event in events if event["event"] == "eval_progress" and event["done"]]
    assert [event["done"] for event in reported] == list(range(1, 10))
    written = read_metrics(tmp_path / "e")
    assert events[-1]["views"] == {view["name"]: view["psnr"] for view in written["views"]}
    found = read_ply(path)
    light = found.sh0.mean(axis=(1, 2))
    assert np.array_equal(found.means, splats.means) and found.sh_degree == 0
    assert np.median(light[wrong]) > np.median(light[~wrong]) + 0.2
    code, _, err = gscore("eval", folder, *options)
    assert code == 2 and "--overwrite" in err
    code, out, _ = gscore("eval", folder, *options, "--overwrite")
    assert code == 0 and str(path) in out


def test_an_error_map_of_no_format(gscore, run_folder, tmp_path):
    """Oracle: the endings of splat files; no files."""
    options = ("-o", tmp_path / "e", "--error-map", tmp_path / "errors.jpg")
    code, _, err = gscore("eval", run_folder(), *options)
    assert code == 2 and ".ply" in err and not (tmp_path / "e").exists()
