"""Measurements of experiments/depth; oracles: two planes with known shadows, counts."""

import json
import sys
from argparse import ArgumentParser
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments.depth import compare
from experiments.depth.captures import few_views, studio
from experiments.depth.compare import _predict, _whole
from experiments.depth.measures import is_seen, known_share
from experiments.depth.plans import ARMS, TABLES, Setting
from experiments.depth.tables import tables
from gscore.commands.args.train_request import TrainRequest
from gscore.commands.train import add_arguments
from gscore.depth.origin import read_record
from gscore.io.images.png import write_png
from gscore.presets import PRESETS


def test_seen_is_what_lies_at_its_depth_in_another_frame() -> None:
    """Oracle: geometry. A wall at z = 4, and in front of it from column 20 on a board at z = 2."""
    K = np.array([[20.0, 0, 20], [0, 20.0, 10], [0, 0, 1]])
    wall = np.full((20, 40), 0.25)
    with_board = wall.copy()
    with_board[:, 20:] = 0.5
    here, right = np.eye(4), np.eye(4)
    right[0, 3] = -1.0  # camera one unit to the right: the wall moves 5 px to the left
    seen = is_seen(wall, K, here, [(K, right, wall)])
    assert not seen[:, :5].any() and seen[:, 5:].all()
    # Pixels that land on the board in the other view are hidden there.
    hidden = is_seen(wall, K, here, [(K, right, with_board)])
    assert hidden[:, 5:25].all() and not hidden[:, 25:].any()
    assert is_seen(wall, K, here, [(K, right, with_board), (K, here, wall)]).all()
    behind = np.diag([-1.0, 1, -1, 1])
    assert not is_seen(wall, K, here, [(K, behind, wall)]).any()
    nothing = np.zeros((20, 40))
    assert not is_seen(nothing, K, here, [(K, here, nothing)]).any()


def _row(arm: str, seed: int, psnr: float, splats: str = "") -> dict[str, Any]:
    return {
        "capture": "c",
        "setting": "120 px",
        "views": 6,
        "asked": "6",
        "known": None,
        "splats": 100,
        "judged": [{"name": "a", "psnr": psnr, "psnr_cc": psnr + 1, "ssim": 0.5, "lpips": None}],
        "arm": arm,
        "seed": seed,
        "psnr": psnr,
        "ssim": 0.5,
        "lpips": None,
        "depth_error": 0.5,
        "depth_error_seen": 0.25,
        "cpu_seconds": 3.0,
        "splats_sha256": splats or arm,
    }


def test_gains_are_of_the_same_seed() -> None:
    """Oracle: 2 and 4 dB, a mean of 3 with a deviation of root two; a seed without its pair."""
    rows = [_row("none", 0, 20), _row("none", 1, 10), _row("mono", 0, 22), _row("mono", 1, 14)]
    rows += [_row("mono", 2, 18), _row("mono-auto", 0, 20, "none"), _row("masked", 0, 30)]
    text = tables(rows, list(ARMS))
    lines = [[cell.strip() for cell in line[1:-1].split("|")] for line in text.splitlines()]
    found = {cells[2]: cells for cells in lines if cells[0] == "c"}
    assert found["none"][3:6] == ["2", "15.00 ± 7.07", ""]
    assert found["mono"][3:6] == ["3", "18.00 ± 4.00", "+3.00 ± 1.41"]
    assert found["mono-auto"][5] == "same splats"
    assert found["masked"][5] == ""
    # One view, so each draw has its 2 and 4 dB; the rule requires 0.1 at equal time.
    assert found["mono"][6] == "+3.00 (+3.00 to +3.00)"
    (evaluated,) = [cells for cells in lines if cells[:2] == ["6", "mono"]]
    assert evaluated[2:4] == ["c", "+3.00 (+3.00 to +3.00)"]
    assert evaluated[4] == "yes: +3.00 dB, surely above 0, 1.00 times as long"


@pytest.mark.parametrize("table", TABLES)
def test_trainings_are_the_presets_own(table: str) -> None:
    """Oracle: the options of the preset, but for the sizes in the table."""
    plan = TABLES[table]
    preset = plan.get("preset", "preview")
    sizes = {key: plan[key] for key in ("iterations", "max_splats", "sh_degree") if key in plan}
    setting = Setting(preset=preset, threads=0, width=plan.get("width", 0), **sizes)
    parser = ArgumentParser()
    add_arguments(parser)
    line = ["capture", "-o", "out", *setting.options, *ARMS["none"]]
    data, train = TrainRequest.of(parser.parse_args(line)).configs()
    wanted_data, wanted = PRESETS[preset](Path("capture"))
    limits = {"iterations": "steps_a_photo", "max_splats": "splats_a_photo"}
    lifted = {limits[key]: 0 for key in sizes if key in limits}  # explicit numbers take precedence
    assert train == replace(wanted, **sizes, **lifted)
    assert data == replace(wanted_data, resolution=plan.get("width", wanted_data.resolution))


def test_stereo_looks_at_no_test_view(tmp_path: Path) -> None:
    """Oracle: the chosen training views, with known depth in a part of their pixels."""
    names = few_views(studio(), 12, tmp_path / "c")
    _predict(tmp_path / "c", "depths-stereo", ["--method", "stereo"])
    record = read_record(tmp_path / "c" / "depths-stereo")
    assert record is not None
    assert sorted(record["photos"]) == names and not set(names) & set(studio().test)
    assert 0 < known_share(tmp_path / "c" / "depths-stereo", names) < 0.5


def test_known_are_pixels_with_a_depth(tmp_path: Path) -> None:
    """Oracle: a quarter of one map, none of a photo without one: an eighth."""
    levels = np.zeros((4, 8), np.uint16)
    levels[:2, :4] = 1000
    write_png(tmp_path / "a.png", levels)
    assert known_share(tmp_path, ["a.jpg", "b.jpg"]) == 0.125


def test_options_of_a_table_can_be_overruled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the table's own entries, and the given one."""
    given = ["x", "--table", "study", "--seeds", "4", "--arms", "none"]
    monkeypatch.setattr(sys, "argv", given)
    args = compare._arguments()
    assert (args.preset, args.width, args.iterations) == ("normal", 480, 3000)
    assert args.seeds == [4]
    assert (args.views, args.arms) == (["50"], ["none"])
    monkeypatch.setattr(sys, "argv", ["x", "--views", "few"])
    with pytest.raises(SystemExit):
        compare._arguments()


def test_a_folder_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    """Oracle: the files there while it is filled, after an error, and when another process was
    first."""
    target = tmp_path / "a"
    with pytest.raises(ValueError, match="stop"), _whole(target) as part:
        (part / "x").write_text("1")
        raise ValueError("stop")
    assert not target.exists()
    with _whole(target) as part:
        (part / "x").write_text("2")
        assert not target.exists()
    with _whole(target) as part:
        (part / "x").write_text("3")
    assert (target / "x").read_text() == "2"
    assert json.loads((target / "x").read_text()) == 2 and len(list(tmp_path.iterdir())) == 1
