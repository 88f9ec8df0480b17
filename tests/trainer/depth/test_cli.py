"""`gscore train -d` from photos to report; oracle: files, messages and the maps' own numbers."""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gscore.commands import main
from gscore.config import DataConfig, Switch, TrainConfig
from gscore.datasets import load_dataset
from gscore.depth.params import FILE
from gscore.events import Estimated, Event, Started, Warn
from gscore.scene import PointCloud
from gscore.trainer.depth.setup import prepare_depth
from gscore.trainer.run import train
from tests.trainer.short_run import DEEP_UNIT

SHORT = ["--iterations", "12", "--max-splats", "200", "--sh-degree", "0"]


def test_depth_reaches_metrics_and_report(
    deep: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: eight maps written with a known scale; pictures and rows in the report."""
    out = tmp_path / "o"
    base = ["train", str(deep), "-o", str(out), *SHORT, "--test-every", "4", "--json"]
    assert main([*base, "-d", "depths", "--depth-align", "official"]) == 0
    reported = capsys.readouterr()
    printed = json.loads(reported.out.splitlines()[-1])
    assert printed["depth"]["used"] is True
    assert printed["depth"]["why"] in reported.err.splitlines()[:8]
    views = float(re.search(r"(\d+) of them on a median point", printed["depth"]["why"])[1])
    weight = min(1, 6 / views)
    assert printed["depth"]["weights"] == pytest.approx([weight, weight])
    assert f"The depth loss has a weight of {weight:.3g}." in printed["depth"]["why"]
    assert "views" not in printed["depth"]
    depth = json.loads((out / "metrics.json").read_text())["depth"]
    assert 0 < depth["depth_error"] < 1
    assert [row["split"] for row in depth["views"]].count("test") == 2
    assert all(row["accepted"] and row["scale"] == DEEP_UNIT for row in depth["views"])
    measured = [row["depth_error"] for row in depth["views"] if row["depth_error"] is not None]
    assert len(measured) >= 4  # balls of 48 px are all edges, which are not trusted
    assert depth["depth_error"] == pytest.approx(np.mean(measured))
    report = (out / "report.html").read_text()
    section = report[report.index('<section id="depth">') :]
    section = section[: section.index("</section>")]
    assert section.count("<img ") == 5 * 8
    assert section.count("<figcaption>aligned prior</figcaption>") == 8
    assert "Fits: 8 of 8 views accepted" in section
    assert f"The depth loss has a weight of {weight:.3g}." in section
    assert len(re.findall(r"<tr><th>view_0\d\.png", section)) == 8


def test_refused_maps_are_reported_with_the_reason(deep: Path, tmp_path: Path) -> None:
    """Oracle: one scale a hundredth of the others, which the official rule calls unreliable."""
    root, out = tmp_path / "capture", tmp_path / "o"
    shutil.copytree(deep, root)
    path = root / "sparse" / "0" / FILE
    params = json.loads(path.read_text())
    params["view_02"]["scale"] = DEEP_UNIT / 100
    path.write_text(json.dumps(params))
    arguments = ["train", str(root), "-o", str(out), *SHORT, "-d", "depths"]
    assert main([*arguments, "--depth-align", "official", "--quiet"]) == 0
    rows = json.loads((out / "metrics.json").read_text())["depth"]["views"]
    assert [row["accepted"] for row in rows].count(False) == 1
    refused = next(row for row in rows if not row["accepted"])
    assert refused["view"] == "view_02.png"
    assert refused["reason"]
    report = (out / "report.html").read_text()
    assert "Fits: 7 of 8 views accepted" in report
    assert "no aligned prior" in report
    assert f"not aligned: {refused['reason'][:20]}" in report


def test_maps_add_points_where_they_supervise(deep: Path) -> None:
    """Oracle: the SfM points, which all stay, and the number in the sentence."""
    data = DataConfig(source=deep, depths="depths", depth_align="official")
    photos = load_dataset(data)
    known = photos.scene.points.points[::40]
    few = PointCloud(points=known, colors=photos.scene.points.colors[::40])
    photos.scene = replace(photos.scene, points=few)
    found = prepare_depth(data, TrainConfig(), photos)
    assert found.points is not None
    np.testing.assert_array_equal(found.points.points[: len(known)], known)
    added = len(found.points) - len(known)
    assert added > 0
    assert found.why.endswith(f" {added} points were added from the maps to {len(known)} of SfM.")
    for config in (
        TrainConfig(depth_points=0),
        TrainConfig(depth_weight=0.0, depth_weight_final=0.0),
        TrainConfig(start_splats=deep / "some.ply"),
        TrainConfig(depth_mode=Switch.OFF),
    ):
        found = prepare_depth(data, config, photos)
        assert found.points is None and "added" not in found.why
    tight = prepare_depth(data, TrainConfig(max_splats=5 * (added // 2)), photos).points
    assert tight is not None and len(tight) - len(known) == added // 2
    fewer = prepare_depth(data, TrainConfig(depth_points=added // 2), photos).points
    assert fewer is not None and len(fewer) - len(known) <= added // 2


@pytest.mark.parametrize("align", ["robust", "none"])
def test_maps_that_say_nothing_do_not_supervise(deep: Path, tmp_path: Path, align: str) -> None:
    """Oracle: maps without a finite value; then one true map among them."""
    root = tmp_path / "capture"
    shutil.copytree(deep, root)
    blank = root / "blank"
    blank.mkdir()
    names = [Path(name).stem for name in load_dataset(DataConfig(source=root)).scene.cameras.names]
    for name in names:
        np.save(blank / f"{name}.npy", np.full((48, 48), np.nan, np.float32))
    data = DataConfig(source=root, depths="blank", depth_align=align)
    config = TrainConfig(depth_mode=Switch.ON)
    photos = load_dataset(data)
    found = prepare_depth(data, config, photos)
    assert not found.supervises and found.loss_targets is None
    assert "No training view has a usable depth map" in found.why
    assert found.why in found.warnings and not found.decision
    np.save(
        blank / f"{names[0]}.npy", np.linspace(0.3, 0.4, 48 * 48, dtype=np.float32).reshape(48, 48)
    )
    one = prepare_depth(data, config, photos)
    assert one.supervises and "supervises 1 " in one.why


def test_points_wanted_and_splats_given(deep: Path) -> None:
    """Oracle: the message that no points will be added, for a run that starts from splats."""
    data = DataConfig(source=deep, depths="depths", depth_align="official")
    photos = load_dataset(data)
    splats = TrainConfig(start_splats=deep / "some.ply")
    both = prepare_depth(data, replace(splats, depth_points=50), photos)
    reported = [w for w in both.warnings if "No points are added" in w]
    assert len(reported) == 1 and "depth_points" in reported[0] and "start_splats" in reported[0]
    for config in (splats, TrainConfig(depth_points=50), replace(splats, depth_points=0)):
        found = prepare_depth(data, config, photos)
        assert not [w for w in found.warnings if "No points are added" in w]


def test_decaying_weights_are_reported(deep: Path) -> None:
    """Oracle: the options."""
    data = DataConfig(source=deep, depths="depths", depth_align="official")
    config = TrainConfig(depth_weight=0.3, depth_weight_final=0.01)
    found = prepare_depth(data, config, load_dataset(data))
    assert found.weights == (0.3, 0.01)
    assert "a weight of 0.3 at first and 0.01 at the end" in found.why


def test_memory_estimate_contains_depth_maps(deep: Path, tmp_path: Path) -> None:
    """Oracle: 11 bytes a pixel of eight maps of 48 x 48 px, on top of a run without them."""
    config = TrainConfig(iterations=2, max_splats=200, sh_degree=0)
    peaks = []
    for depths in ("", "depths"):
        events: list[Event] = []
        data = DataConfig(source=deep, depths=depths, depth_align="official")
        train(config, data, tmp_path / f"o{depths}", events.append)
        peaks.append(next(e for e in events if isinstance(e, Estimated)).peak_bytes)
    assert peaks[1] - peaks[0] == 11 * 8 * 48 * 48


def test_off_reads_maps_but_trains_without(deep: Path, tmp_path: Path) -> None:
    """Oracle: the bytes of the splats of a run without maps; the reason in the report."""
    arguments = ["train", str(deep), *SHORT, "--quiet"]
    assert main([*arguments, "-o", str(tmp_path / "a")]) == 0
    off = ["-d", "depths", "--depth-align", "official", "--depth-mode", "off"]
    assert main([*arguments, "-o", str(tmp_path / "b"), *off]) == 0
    plain, read = ((tmp_path / name / "point_cloud.ply").read_bytes() for name in "ab")
    assert plain == read
    depth = json.loads((tmp_path / "b" / "metrics.json").read_text())["depth"]
    assert depth["used"] is False and depth["weights"] == [0, 0]
    assert "depth_mode off" in (tmp_path / "b" / "report.html").read_text()
    assert "depth" not in json.loads((tmp_path / "a" / "metrics.json").read_text())


def test_maps_that_are_not_wanted_are_no_warning(deep: Path, tmp_path: Path) -> None:
    """Oracle: the option; the decision among the first messages of a training."""
    events: list[Event] = []
    config = TrainConfig(iterations=2, max_splats=200, sh_degree=0, depth_mode=Switch.OFF)
    data = DataConfig(source=deep, depths="depths", depth_align="official")
    train(config, data, tmp_path / "o", events.append)
    said = next(e for e in events if isinstance(e, Started)).decision("depth")
    assert said == "Depth maps are read for the report only (depth_mode off)."
    assert not [e for e in events if isinstance(e, Warn) and e.code == "depth"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--depth-mode", "on"], "--depths"),
        (["--depth-points", "10"], "--depths"),
        (["-d", "nowhere"], "nowhere"),
        (["-d", "depths", "--depth-weight", "-2"], "depth_weight must be auto, or 0 to 1e+09"),
        (["--drop-rate", "1"], "drop_rate must be 0 to less than 1, got 1"),
    ],
)
def test_bad_options_are_one_sentence_and_leave_nothing(
    deep: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    words: str,
) -> None:
    """Oracle: the exit code, the message and no output folder."""
    out = tmp_path / "o"
    assert main(["train", str(deep), "-o", str(out), *SHORT, *options]) != 0
    assert words in capsys.readouterr().err
    assert not out.exists()


def test_a_run_with_depth_resumes(
    deep: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: the splats of an uninterrupted run; a refusal of other maps."""
    depth = ["-d", "depths", "--depth-align", "official"]
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    short = ["train", str(deep), "--max-splats", "200", "--sh-degree", "0", "--quiet", *depth]
    checkpoints = ["--iterations", "20", "--checkpoint-iterations", "10"]
    assert main([*short, *checkpoints, "-o", str(whole)]) == 0
    start = whole / "checkpoints" / "step_00000010.safetensors"
    assert main([*short, *checkpoints, "-o", str(parts), "--start-checkpoint", str(start)]) == 0
    ends = [(path / "point_cloud.ply").read_bytes() for path in (whole, parts)]
    assert ends[0] == ends[1]
    none = [*short[:6], "--quiet", *checkpoints, "-o", str(tmp_path / "c")]
    capsys.readouterr()
    assert main([*none, "--start-checkpoint", str(start)]) != 0
    assert "with depth maps in the loss, this one has none" in capsys.readouterr().err


@pytest.fixture
def one_view_unknown(deep: Path, tmp_path: Path) -> Callable[[], Path]:
    """A copy of the capture without the map of one view."""

    def make() -> Path:
        root = tmp_path / "capture"
        shutil.copytree(deep, root)
        (root / "depths" / "view_05.png").unlink()
        return root

    return make


def test_views_without_a_map_train_without_depth(
    one_view_unknown: Callable[[], Path], tmp_path: Path
) -> None:
    """Oracle: the number of views in the sentence, and the row of the missing one."""
    arguments = ["train", str(one_view_unknown()), "-o", str(tmp_path / "o"), *SHORT, "--quiet"]
    assert main([*arguments, "-d", "depths", "--depth-align", "official"]) == 0
    depth = json.loads((tmp_path / "o" / "metrics.json").read_text())["depth"]
    assert "supervises 7 training views" in depth["why"]
    row = next(row for row in depth["views"] if row["view"] == "view_05.png")
    assert row["map"] is None
    assert row.get("depth_error") is None
