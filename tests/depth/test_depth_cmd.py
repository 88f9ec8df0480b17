"""`gscore depth` from photos to depth_params.json, with networks that compute known functions."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image

from gscore.config import DataConfig, Switch
from gscore.datasets import load_dataset
from gscore.depth import load_priors
from gscore.events import DepthDone, DepthProgress, Failed, from_line
from gscore.frontend import read_colmap, write_colmap
from gscore.io.images.png import write_png
from gscore.trainer.depth.rule import coverage, decide

MAKERS = {
    "midas": ("midas", {"size": 256}),
    "dpt": ("transformer", {"patch": 16, "shape": [1, 3, 384, 384]}),
    "anything": ("transformer", {"patch": 14, "shape": [1, 3, "h", "w"]}),
    "metric": ("metric", {}),
}


def _network(networks, name, folder):
    maker, options = MAKERS[name]
    return networks[maker](folder / f"{name}.onnx", **options)


def _code(path):
    """[H, W] of a 16-bit PNG."""
    code = np.asarray(Image.open(path))
    assert code.dtype == np.uint16
    return code.astype(np.float64)


@pytest.mark.parametrize("name", MAKERS)
def test_from_photos_to_aligned_depth(planes, networks, gscore, tmp_path, name):
    """Oracle: the planes: photos show inverse depth as grey, the networks are affine in grey or
    return depth, so scale * value + offset must be the inverse depth of every pixel."""
    model = _network(networks, name, tmp_path)
    options = ("--normalization", "unit") if name == "metric" else ()
    code, out, err = gscore("depth", planes.folder, "--model", model, "--json", *options)
    assert code == 0, err
    result = json.loads(out.splitlines()[-1])
    assert (result["views"], result["predicted"], result["accepted"]) == (5, 5, 5)
    assert result["kind"] == "inverse" and len(result["table"]) == 5
    params = json.loads((planes.folder / "sparse" / "0" / "depth_params.json").read_text())
    assert set(params) == {f"cam/v_{i}" for i in range(5)}
    for i in range(5):
        value = _code(planes.folder / "depths" / "cam" / f"v_{i}.png")
        assert value.shape == (80, 120) and value.min() == 1 and value.max() == 65535
        entry = params[f"cam/v_{i}"]
        inverse = value / 65536 * entry["scale"] + entry["offset"]
        off = np.abs(inverse / planes.truth(i) - 1)[4:-4, 4:-4]
        # Photos of 8 bits store inverse depth to half a percent; patches blur the crease.
        assert np.median(off) < 0.008 and np.quantile(off, 0.95) < 0.04
        assert entry["inliers"] > 0.9
    sheet = np.asarray(Image.open(planes.folder / "depths" / "contact_sheet.png"))
    assert sheet.dtype == np.uint8 and sheet.shape[2] == 3
    record = json.loads((planes.folder / "depths" / "prediction.json").read_text())
    assert record["model"] == model.name and record["kind"] == (
        "depth" if name == "metric" else "inverse"
    )
    config = DataConfig(source=planes.folder, depths="depths", resolution=1)
    priors = load_priors(config, load_dataset(config))
    assert all(view.aligned for view in priors.views)


def test_official_rule_from_files_alone(planes, networks, gscore, tmp_path, official_by_hand):
    """Oracle: the official rule in plain Python on the PNGs and the model as read by pycolmap."""
    model = _network(networks, "midas", tmp_path)
    code, _, err = gscore("depth", planes.folder, "--model", model, "--align", "official")
    assert code == 0, err
    params = json.loads((planes.folder / "sparse" / "0" / "depth_params.json").read_text())
    reconstruction = pycolmap.Reconstruction(str(planes.folder / "sparse" / "0"))
    for image in reconstruction.images.values():
        name = image.name.removesuffix(".png")
        values = _code(planes.folder / "depths" / f"{name}.png") / 65536
        points = []
        for point in image.points2D:
            if point.has_point3D():
                xyz = reconstruction.points3D[point.point3D_id].xyz
                z = (image.cam_from_world() * xyz)[2]
                points.append((float(point.xy[0]), float(point.xy[1]), 1 / z))
        scale, offset = official_by_hand(values.tolist(), points, 120, 80)
        assert params[name]["scale"] == pytest.approx(scale, rel=1e-4)
        assert params[name]["offset"] == pytest.approx(offset, abs=1e-4 * scale)


def test_it_goes_on_where_it_stopped(planes, networks, gscore, tmp_path):
    """Oracle: the times of the files: existing ones stay, missing ones are made."""
    model = _network(networks, "midas", tmp_path)
    run = ("depth", planes.folder, "--model", model, "--json", "--quiet")
    assert gscore(*run)[0] == 0
    maps = [planes.folder / "depths" / "cam" / f"v_{i}.png" for i in range(5)]
    before = [path.read_bytes() for path in maps]
    maps[1].unlink()
    maps[3].unlink()
    times = {path: path.stat().st_mtime_ns for path in maps if path.exists()}
    code, out, _ = gscore(*run)
    result = json.loads(out)
    assert (code, result["predicted"], result["kept"]) == (0, 2, 3)
    assert {path: path.stat().st_mtime_ns for path in times} == times
    assert [path.read_bytes() for path in maps] == before
    result = json.loads(gscore(*run, "--overwrite")[1])
    assert (result["predicted"], result["kept"]) == (5, 0)


def test_maps_of_others_are_not_overwritten(planes, networks, gscore, tmp_path):
    """Oracle: the files' bytes; another model, another input scaling, and maps of other
    programs."""
    planes.write_maps(lambda path, s: np.save(path, s))
    model = _network(networks, "midas", tmp_path)
    there = planes.folder / "depths" / "cam" / "v_0.npy"
    before = there.read_bytes()
    code, _, err = gscore("depth", planes.folder, "--model", model)
    assert (
        code == 2
        and "already contains depth maps of 5 views" in err
        and "--overwrite" in err
        and "--depths" in err
    )
    assert there.read_bytes() == before
    assert gscore("depth", planes.folder, "--model", model, "-d", "mono", "--quiet")[0] == 0
    # The file next to the model is for depths/; this folder has its own.
    assert (planes.folder / "mono" / "depth_params.json").is_file()
    assert not (planes.folder / "sparse" / "0" / "depth_params.json").exists()
    other = _network(networks, "dpt", tmp_path)
    code, _, err = gscore("depth", planes.folder, "--model", other, "-d", "mono")
    assert code == 2 and "made by midas.onnx" in err
    options = ("-d", "mono", "--normalization", "half")
    code, _, err = gscore("depth", planes.folder, "--model", model, *options)
    assert code == 2 and "another normalization" in err


def test_overwriting_maps_of_another_kind(planes, networks, gscore, tmp_path):
    """Oracle: the predicted PNG after --overwrite, also with an NPY next to it."""
    planes.write_maps(lambda path, s: np.save(path, s))
    model = _network(networks, "midas", tmp_path)
    code, out, _ = gscore("depth", planes.folder, "--model", model, "--overwrite", "--json")
    assert code == 0
    assert {row["map"] for row in json.loads(out)["table"]} == {f"v_{i}.png" for i in range(5)}


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_stopping_leaves_whole_files(make_planes, networks, tmp_path, number):
    """Oracle: exit code 128 + signal, every PNG readable, no temporary file; the same command
    finishes the rest."""
    planes = make_planes(views=20)
    model = networks["midas"](tmp_path / "n.onnx", size=1024)  # large enough to take seconds
    command = [sys.executable, "-m", "gscore", "depth", str(planes.folder), "--model", str(model)]
    environment = dict(os.environ, PYTHONPATH=str(Path(__file__).parents[2]))
    process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
    folder = planes.folder / "depths"
    deadline = time.monotonic() + 60
    while not list(folder.rglob("*.png")) and time.monotonic() < deadline:
        time.sleep(0.005)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 128 + number, err
    assert "Run the same command again" in err
    done = list(folder.rglob("*.png"))
    assert 0 < len(done) < 20
    for path in done:
        assert _code(path).shape == (80, 120)
    assert not list(folder.rglob("*.tmp"))
    assert not (planes.folder / "sparse" / "0" / "depth_params.json").exists()
    again = subprocess.run([*command, "--json"], env=environment, capture_output=True, text=True)
    result = json.loads(again.stdout)
    assert result["kept"] == len(done) and result["predicted"] == 20 - len(done)


def test_composite_masks_are_left_out_of_the_maps(planes, networks, gscore, tmp_path):
    """Oracle: 0 exactly where opacity is below one half; hidden pixels change nothing."""
    mask = np.zeros((80, 120), np.uint8)
    mask[10:70, 20:90] = 255
    for name in planes.names:
        write_png(planes.folder / "masks" / name, mask)
    model = _network(networks, "midas", tmp_path)
    options = ("--mask-mode", "composite", "--quiet")
    assert gscore("depth", planes.folder, "--model", model, *options)[0] == 0
    path = planes.folder / "depths" / "cam" / "v_0.png"
    assert np.array_equal(_code(path) > 0, mask > 0)
    photo = planes.folder / "images" / planes.names[0]
    shown = np.asarray(Image.open(photo)).copy()
    shown[mask == 0] = 255
    write_png(photo, shown)
    first = path.read_bytes()
    assert gscore("depth", planes.folder, "--model", model, *options, "--overwrite")[0] == 0
    assert path.read_bytes() == first
    # Masks that exclude pixels from training leave the map whole; the trainer applies them.
    options = ("--mask-mode", "ignore", "--quiet", "--overwrite")
    assert gscore("depth", planes.folder, "--model", model, *options)[0] == 0
    assert (_code(path) > 0).all()


def test_aligning_what_is_there(planes, gscore):
    """Oracle: metric maps of another program: depth is detected and recorded, for gscore to read
    back."""
    planes.write_maps(lambda path, s: np.save(path, 3 / s))
    code, out, _ = gscore("depth", planes.folder)
    assert code == 0 and "5 of 5 maps of depth aligned by the robust rule" in out
    params = json.loads((planes.folder / "sparse" / "0" / "depth_params.json").read_text())
    assert params["cam/v_0"]["kind"] == "depth"
    assert params["cam/v_0"]["scale"] == pytest.approx(3, rel=1e-3)
    config = DataConfig(source=planes.folder, depths="depths", resolution=1)
    priors = load_priors(config, load_dataset(config))
    assert priors.views[0].inverse_depth == pytest.approx(planes.truth(0), rel=2e-3)


def test_scales_of_others_are_not_overwritten(planes, gscore):
    """Oracle: the file's bytes: exact scales by hand stay, those written by gscore are renewed, and
    an empty file is replaced with a message."""
    planes.write_maps(lambda path, s: np.save(path, s / 4))
    path = planes.folder / "sparse" / "0" / "depth_params.json"
    entries = {f"cam/v_{i}": {"scale": 4.0, "offset": 0.0} for i in range(5)}
    path.write_text(json.dumps(entries))
    before = path.read_bytes()
    code, _, err = gscore("depth", planes.folder)
    assert code == 2 and "not written by gscore depth" in err and "--overwrite" in err
    assert path.read_bytes() == before
    assert gscore("depth", planes.folder, "--check", "--quiet") == (0, "", "")
    assert path.read_bytes() == before
    code, _, err = gscore("depth", planes.folder, "--overwrite")
    assert code == 0 and "written by another program, are replaced" in err
    own = path.read_bytes()
    path.write_bytes(own.replace(b'"offset": ', b'"offset": 9'))
    assert gscore("depth", planes.folder, "--quiet") == (0, "", "")
    assert path.read_bytes() == own
    path.write_text("{")
    code, _, err = gscore("depth", planes.folder)
    assert code == 0 and "not JSON" in err and "file is replaced" in err
    assert path.read_bytes() == own


def test_quiet_means_errors_alone(planes, gscore):
    """Oracle: no output on either stream, and the file."""
    planes.write_maps(lambda path, s: np.save(path, s))
    assert gscore("depth", planes.folder, "--quiet") == (0, "", "")
    assert (planes.folder / "sparse" / "0" / "depth_params.json").is_file()


def test_wrong_kind_is_refused_with_the_reason(planes, gscore):
    """Oracle: depth declared as inverse depth: no view is accepted, with the reason in the
    table."""
    planes.write_maps(lambda path, s: np.save(path, 3 / s))
    code, out, err = gscore("depth", planes.folder, "--kind", "inverse", "--json")
    result = json.loads(out)
    assert code == 0 and result["accepted"] == 0
    assert "farther" in result["table"][0]["reason"] and "5 of 5" in err
    params = json.loads((planes.folder / "sparse" / "0" / "depth_params.json").read_text())
    assert params["cam/v_0"]["scale"] == 0


def test_neither_model_nor_maps(planes, gscore, tmp_path):
    """Oracle: one sentence with the source of models; no files."""
    for arguments in ((), ("--model", tmp_path / "none.onnx")):
        code, _, err = gscore("depth", planes.folder, *arguments)
        assert code == 2 and "github.com/isl-org/MiDaS/releases" in err
        assert "--list-models" in err and "Traceback" not in err
        assert ("--method stereo, which needs no network" in err) == (not arguments)
    assert not (planes.folder / "depths").exists()
    code, _, err = gscore("depth", tmp_path / "nowhere")
    assert code == 2 and "nowhere" in err


def test_a_blind_network(planes, networks, gscore, tmp_path):
    """Oracle: an error that names the view for one value everywhere, instead of a map of zeros."""
    model = networks["midas"](tmp_path / "n.onnx", inside=([1e6] * 3, [1.0] * 3))
    code, _, err = gscore("depth", planes.folder, "--model", model)
    assert code == 2 and "cam/v_0.png one value everywhere" in err
    assert not list((planes.folder / "depths").rglob("*.png"))


def test_events_tell_what_happens(planes, networks, gscore, tmp_path):
    """Oracle: the number of views, and the output of --json."""
    model = _network(networks, "midas", tmp_path)
    code, out, _ = gscore("depth", planes.folder, "--model", model, "--events", "jsonl")
    events = [from_line(line) for line in out.splitlines()]
    assert code == 0 and None not in events
    reported = [(e.phase, e.done, e.total) for e in events if isinstance(e, DepthProgress)]
    network, *_ = reported[1]
    assert network.startswith("predicting with midas.onnx, detected as MiDaS 2.1 small")
    expected = [("reading", 0, 0), (network, 0, 5)]
    expected += [(phase, i, 5) for phase in ("predicting", "aligning") for i in range(1, 6)]
    assert reported == expected
    done = events[-1]
    assert isinstance(done, DepthDone) and (done.views, done.predicted) == (5, 5)
    result = json.loads(gscore("depth", planes.folder, "--json")[1])
    assert done.table == result["table"] and done.accepted == result["accepted"] == 5
    assert Path(done.params).is_file() and Path(done.sheet).is_file()
    code, out, _ = gscore("depth", planes.folder, "-d", "x", "--events", "jsonl")
    failed = from_line(out.splitlines()[-1])
    assert code == 2 and isinstance(failed, Failed) and "no folder" in failed.message


def test_a_line_stops_it_between_views(make_planes, networks, tmp_path):
    """Oracle: whole maps, no scales, and a last event about the stop."""
    planes = make_planes(views=20)
    model = networks["midas"](tmp_path / "n.onnx", size=1024)
    command = [sys.executable, "-m", "gscore", "depth", str(planes.folder), "--model", str(model)]
    environment = dict(os.environ, PYTHONPATH=str(Path(__file__).parents[2]))
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([*command, "--events", "jsonl"], env=environment, **pipes) as process:
        for line in process.stdout:
            event = from_line(line)
            if isinstance(event, DepthProgress) and event.done == 2:
                process.stdin.write("stop\n")
                process.stdin.flush()
        last = event
    assert isinstance(last, Failed) and last.type == "Cancelled" and "again" in last.message
    assert 2 <= len(list((planes.folder / "depths").rglob("*.png"))) < 20
    assert not (planes.folder / "sparse" / "0" / "depth_params.json").exists()


def test_checking_writes_nothing(planes, gscore):
    """Oracle: the table of `load_priors`, and the files before and after."""
    planes.write_maps(lambda path, s: np.save(path, 3 / s))
    blind = planes.folder / "depths" / "cam" / "v_2.npy"
    np.save(blind, np.ones((80, 120)))
    before = sorted(planes.folder.rglob("*"))
    code, out, _ = gscore("depth", planes.folder, "--check", "--json")
    result = json.loads(out)
    assert code == 0 and (result["accepted"], result["params"], result["sheet"]) == (4, None, None)
    assert sorted(planes.folder.rglob("*")) == before
    config = DataConfig(source=planes.folder, depths="depths", resolution=1)
    dataset = load_dataset(config)
    assert result["table"] == load_priors(config, dataset).table
    facts = coverage(dataset.scene, range(5))
    assert result["why"] == decide(Switch.AUTO, facts, usable=5)[1]
    code, out, _ = gscore("depth", planes.folder, "--check")
    assert code == 0 and "nothing was written" in out and result["why"] in out
    assert gscore("depth", planes.folder, "--check", "--overwrite")[0] == 2


@pytest.mark.parametrize("folder", ["images", "", ".", "images/../images"])
def test_photos_are_never_replaced_by_maps(planes, networks, gscore, tmp_path, folder):
    """Oracle: the photos, which have the names of the maps."""
    before = {p: p.read_bytes() for p in planes.folder.rglob("*.*") if p.is_file()}
    model = _network(networks, "midas", tmp_path)
    code, _, err = gscore(
        "depth", planes.folder, "--model", model, "-d", folder, "--overwrite", "--quiet"
    )
    assert code == 2 and "where results would mix with" in err
    assert {p: p.read_bytes() for p in planes.folder.rglob("*.*") if p.is_file()} == before


@pytest.mark.parametrize("power", [-160, -300])
@pytest.mark.parametrize("method", ["network", "stereo"])
def test_captures_of_any_size(planes, gscore, recwarn, method, power):
    """Oracle: a capture scaled to 1e-160 units: maps are aligned without a warning of numpy;
    stereo, whose inverse depths no float32 holds, finds none, in a sentence."""
    model = read_colmap(planes.folder / "sparse" / "0")
    size = 10.0**power
    points = replace(model.points, xyz=model.points.xyz * size)
    images = [replace(image, tvec=image.tvec * size) for image in model.images]
    write_colmap(replace(model, images=images, points=points), planes.folder / "sparse" / "0")
    planes.write_maps(lambda path, s: np.save(path, s))
    options = ("--method", "stereo", "--overwrite") if method == "stereo" else ()
    code, _, err = gscore("depth", planes.folder, *options)
    assert code == (2 if options else 0)
    assert "inverse depths must be" not in err and ("found no depth" in err) == bool(options)
    assert not [str(one) for one in recwarn if issubclass(one.category, RuntimeWarning)]
