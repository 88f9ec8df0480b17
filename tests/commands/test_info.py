"""gscore info: its output for captures, models and runs."""

import json
import math
import os
import shutil
from dataclasses import replace

import numpy as np
import pytest

from gscore.config_file import config_json, load_config
from gscore.io.colmap.folder import read_model, write_model
from gscore.io.images.png import write_png
from gscore.io.lock import FolderLock
from gscore.io.ply.splats import write_splats
from gscore.io.runs import RUN_LOCK, checkpoint_path
from gscore.io.sequences import SequenceIndex, write_sequence
from gscore.text_format import time_text
from tests.commands.conftest import STEPS


def test_capture(gscore, capture, ring):
    """Oracle: the parameters that made the capture."""
    code, out, _ = gscore("info", capture, "--json")
    facts = json.loads(out)
    assert code == 0 and facts["kind"] == "capture" and facts["views"] == 9
    assert facts["sizes"] == {"48 x 36": 9} and facts["points"] == 60
    assert facts["names"] == ["a_0.png", "a_8.png"] and facts["masks"] == "none"
    assert facts["focal_px"] == pytest.approx([45, 45])
    assert facts["focal_y_px"] == pytest.approx([47, 47])
    assert facts["camera_extent"] == pytest.approx(1.1 * 5, rel=1e-6)
    assert facts["model"]["cameras"] == {"PINHOLE": 1}
    assert facts["model"]["mean_error_px"] == pytest.approx(0.5)
    assert facts["decoded_bytes"] >= 9 * 48 * 36 * 3
    code, out, _ = gscore("info", capture)
    assert code == 0 and "9 photos (9 of 48 x 36 px)" in out and "1 PINHOLE" in out
    assert "focal length 45.0 px across and 47.0 px down, camera" in " ".join(out.split())


def test_undistortion_is_reported(gscore, capture, tmp_path):
    """Oracle: the same capture with another camera model."""
    folder = tmp_path / "bent"
    shutil.copytree(capture, folder)
    model = read_model(folder)
    camera = replace(model.cameras[1], model="SIMPLE_RADIAL", params=np.array([45.0, 24, 18, 0.1]))
    write_model(replace(model, cameras={1: camera}), folder / "sparse/0")
    code, out, _ = gscore("info", folder)
    assert code == 0 and "px after undistortion, camera" in " ".join(out.split())


def test_ply(gscore, splats, tmp_path):
    """Oracle: quantiles of the written arrays."""
    path = tmp_path / "m.ply"
    write_splats(path, splats, comments=("SplatRenderMode: mip",))
    code, out, _ = gscore("info", path, "--json")
    facts = json.loads(out)
    assert code == 0 and facts["splats"] == 60 and facts["sh_degree"] == 1
    assert facts["storage_bytes"] == path.stat().st_size and facts["antialias"] is True
    assert facts["comments"] == ["SplatRenderMode: mip"] and facts["layout"] == "3DGS"
    opacity = 1 / (1 + np.exp(-splats.opacities.astype(float)))
    assert facts["opacity"][2] == pytest.approx(np.median(opacity))
    assert facts["bounds"] == pytest.approx(
        np.stack([splats.means.min(axis=0), splats.means.max(axis=0)]), abs=1e-6
    )
    ratio = np.exp(np.ptp(splats.scales, axis=1))
    assert facts["elongation"][-1] == pytest.approx(ratio.max(), rel=1e-5)
    assert facts["largest_scale"][0] == pytest.approx(
        math.exp(splats.scales.max(axis=1).min()), rel=1e-5
    )
    code, out, _ = gscore("info", path)
    assert code == 0 and "60 splats, SH degree 1" in out and "antialiasing" in out


def test_splats_that_nobody_sees(gscore, splats, tmp_path):
    """Oracle: a third of them, made transparent; no message about none."""
    path = tmp_path / "m.ply"
    for opacity, words in ((4.0, ()), (-8.0, ("  33.3 % have an opacity below 0.005",))):
        opacities = np.full(60, 4, np.float32)
        opacities[:20] = opacity
        write_splats(path, replace(splats, opacities=opacities))
        code, out, _ = gscore("info", path)
        assert code == 0 and all(sentence in out for sentence in words)
        assert ("could be removed" in out) == bool(words)


def test_ply_with_broken_rows(gscore, splats, tmp_path):
    """Oracle: one row of NaN, left out and reported, in the JSON and in the text."""
    broken = splats.subset(np.arange(60))
    broken.means[3] = np.nan
    write_splats(tmp_path / "m.ply", broken)
    code, out, err = gscore("info", tmp_path / "m.ply", "--json")
    facts = json.loads(out)
    assert code == 0 and facts["splats"] == 59 and "1 of 60 splats" in facts["warnings"][0]
    assert err == ""
    assert "Warning: " in gscore("info", tmp_path / "m.ply")[1]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [3e38, -3e38])
def test_ply_of_numbers_beyond_reason(gscore, splats, tmp_path, value):
    """Oracle: JSON, which has no word for NaN."""
    wild = splats.subset(np.arange(60))
    wild.scales[0, 0] = wild.scales[1] = wild.opacities[0] = value
    write_splats(tmp_path / "m.ply", wild)
    code, out, err = gscore("info", tmp_path / "m.ply", "--json")

    def refused(word):
        raise AssertionError(word)

    facts = json.loads(out, parse_constant=refused)
    assert code == 0 and err == "" and facts["splats"] == 60
    assert facts["elongation"][-1] > 1e100 and facts["opacity"][-1] <= 1


def test_empty_ply(gscore, splats, tmp_path):
    """Oracle: no splats, no statistics, no error."""
    write_splats(tmp_path / "m.ply", splats.subset(np.zeros(60, bool)))
    code, out, _ = gscore("info", tmp_path / "m.ply", "--json")
    assert code == 0 and json.loads(out)["splats"] == 0
    assert gscore("info", tmp_path / "m.ply")[0] == 0


def test_run(gscore, run_folder, capture):
    """Oracle: the files of the run."""
    folder = run_folder()
    code, out, _ = gscore("info", folder, "--json")
    facts = json.loads(out)
    assert code == 0 and facts["kind"] == "run" and facts["source"] == str(capture)
    assert facts["metrics"]["steps"] == STEPS and facts["model"]["splats"] == 60
    code, out, _ = gscore("info", folder)
    metrics = facts["metrics"]
    took = f"{STEPS} steps in {time_text(metrics['train_seconds'])}"
    assert f"PSNR {metrics['psnr']:.2f}" in out and took in out and "60 splats" in out
    (folder / "point_cloud.ply").unlink()
    (folder / "metrics.json").unlink()
    code, out, _ = gscore("info", folder)
    assert code == 0 and "no point_cloud.ply yet" in out


def test_photos_that_are_blurred_or_trained_in_part(gscore, run_folder):
    """Oracle: the run's metrics.json, changed."""
    folder = run_folder()
    assert "training photos" not in gscore("info", folder)[1]
    metrics = json.loads((folder / "metrics.json").read_text())
    found = {"transients": {"a.jpg": 0.1, "b.jpg": 0.02}, "blurs": {"b.jpg": 3.5}}
    (folder / "metrics.json").write_text(json.dumps(metrics | found))
    assert "training photos: 2 with parts left out, 1 blurred (see" in gscore("info", folder)[1]
    facts = json.loads(gscore("info", folder, "--json")[1])
    assert {key: facts["metrics"][key] for key in found} == found


def test_a_run_that_was_stopped(gscore, run_folder):
    """Oracle: the run's metrics.json, changed; a later checkpoint takes precedence."""
    folder = run_folder()
    code, out, _ = gscore("info", folder, "--json")
    facts = json.loads(out)
    assert code == 0 and facts["unfinished"] == "" and not facts["in_training"]
    metrics = json.loads((folder / "metrics.json").read_text())
    (folder / "metrics.json").write_text(
        json.dumps(metrics | {"reason": "interrupted", "steps": STEPS})
    )
    data, train = load_config(folder / "config.json")
    (folder / "config.json").write_text(config_json(data, replace(train, iterations=3000)))
    words = f"stopped after {STEPS} of 3,000 steps"
    out = gscore("info", folder)[1]
    assert f"{words}; continue with: gscore train -o {folder} --resume" in " ".join(out.split())
    checkpoint_path(folder, 40).write_bytes(b"")
    assert "its last checkpoint is after 40 of 3,000 steps; continue" in gscore("info", folder)[1]


def test_a_run_in_training(gscore, run_folder, tmp_path):
    """Oracle: a lock of a running process; the lock of a killed process is ignored."""
    folder, begun = run_folder(), tmp_path / "begun"
    for path in (folder, begun):
        lock = FolderLock(path, RUN_LOCK, "training")
        lock.take()
        code, out, _ = gscore("info", path)
        assert code == 0 and f"in training now, by process {os.getpid()}" in out
        assert json.loads(gscore("info", path, "--json")[1])["process"] == os.getpid()
        assert "--resume" not in out
        lock.release()
    (folder / RUN_LOCK).write_text('{"pid": 1}')
    assert "in training" not in gscore("info", folder)[1]


def test_layout_of_3dgs_runs(gscore, splats, tmp_path):
    """Oracle: the last of several iterations, by number and not by name."""
    for step in (700, 7000, 30000):
        count = step // 700
        ply = tmp_path / "point_cloud" / f"iteration_{step}" / "point_cloud.ply"
        write_splats(ply, splats.subset(np.arange(count)))
    code, out, _ = gscore("info", tmp_path, "--json")
    facts = json.loads(out)
    assert code == 0 and facts["model"]["splats"] == 42 and facts["source"] is None


def test_missing_path(gscore, tmp_path):
    """Oracle: exit code 2 and a sentence."""
    code, _, err = gscore("info", tmp_path / "none")
    assert code == 2 and "There is no file or folder" in err
    code, _, err = gscore("info", tmp_path)
    assert code == 2 and "is an empty folder" in err
    (tmp_path / "x.txt").write_text("hello")
    code, _, err = gscore("info", tmp_path / "x.txt")
    assert code == 2 and "contains no splats in a supported format" in err


def test_inverted_masks_in_every_verb(gscore, capture, cameras, tmp_path, monkeypatch):
    """Oracle: a mask that keeps all but one corner, and its opposite: config and pixels."""
    folder = tmp_path / "capture"
    shutil.copytree(capture, folder)
    hidden = np.zeros((36, 48), np.uint8)
    hidden[:9, :12] = 255
    for name in cameras.names:
        write_png(folder / "masks" / f"{name}.png", hidden)
    code, out, _ = gscore("info", folder, "--invert-masks", "--json")
    assert code == 0 and json.loads(out)["masks_inverted"] is True
    code, out, _ = gscore("info", folder, "--invert-masks")
    assert "masks: ignore inverted" in out
    code, out, err = gscore(
        "train", folder, "-o", tmp_path / "run", "--invert-masks", "--iterations", "3", "--json"
    )
    assert code == 0, err
    assert (
        json.loads((tmp_path / "run" / "config.json").read_text())["data"]["invert_masks"] is True
    )
    for options, share in (((), 15 / 16), (("--no-invert-masks",), 1 / 16)):
        code, out, _ = gscore("eval", tmp_path / "run", "--json", *options)
        assert code == 0
        view = json.loads((tmp_path / "run" / "metrics.json").read_text())["views"][0]
        assert 10 ** ((view["psnr_masked"] - view["psnr"]) / 10) == pytest.approx(share, rel=1e-3)
    code, _, err = gscore(
        "train", folder, "-o", tmp_path / "run", "--resume", "--no-invert-masks",
        "--iterations", "9",
    )  # fmt: skip
    assert code == 2 and "other" in err


def test_sequence_is_evaluated_inside_its_masks(gscore, tmp_path):
    """Oracle: the figure of `gscore.headline_psnr`, under its name in runs."""
    frame = {"frame": 0, "folder": "frame_000000", "split": "test", "psnr": 30.0}
    frame |= {"psnr_masked": 22.5, "ssim": 0.9}
    write_sequence(tmp_path, SequenceIndex(options={}, frames=[frame], mean={}), version="1")
    _, out, _ = gscore("info", tmp_path)
    assert "test views: PSNR inside the masks 22.50 dB (30.00 dB with" in out
