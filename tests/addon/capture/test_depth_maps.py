"""Oracle: gscore's own tables and files, and numbers written by hand."""

import json
from pathlib import Path

import pytest

from addon.capture.depth_maps import (
    ACCEPTED,
    MISSING,
    REFUSED,
    UNKNOWN,
    DepthRow,
    from_table,
    read_run_report,
)
from addon.core import stated_depth
from tests.addon.captures import STUDIO

TABLE = [
    {
        "view": "b/v_2.jpg",
        "map": "v_2.png",
        "points": 120,
        "scale": 4.25,
        "offset": -0.125,
        "inliers": 0.9,
        "error": 0.021,
        "accepted": True,
        "reason": "",
        "split": "test",
        "depth_error": 0.04,
    },
    {
        "view": "b/v_1.jpg",
        "map": "v_1.png",
        "points": 7,
        "scale": 0.0,
        "offset": 0.0,
        "inliers": 0.0,
        "error": None,
        "accepted": False,
        "reason": "only 7 points are seen in it",
        "split": "train",
    },
    {"view": "a.jpg", "map": None, "accepted": False, "reason": "there is no depth map of it"},
    {"view": "c.jpg", "map": "c.npy", "accepted": None, "reason": "not compared yet"},
]


def test_rows_of_every_kind() -> None:
    """Oracle: the table above; rows are sorted by name, a refused map is compared by
    correlation."""
    report = from_table(TABLE, why="because")
    assert [row.view for row in report.rows] == ["a.jpg", "b/v_1.jpg", "b/v_2.jpg", "c.jpg"]
    assert [row.verdict for row in report.rows] == [MISSING, REFUSED, ACCEPTED, UNKNOWN]
    assert report.counts == {MISSING: 1, REFUSED: 1, ACCEPTED: 1, UNKNOWN: 1}
    good, bad = report.by_view["b/v_2.jpg"], report.by_view["b/v_1.jpg"]
    assert (good.name, good.fit, bad.fit) == ("b/v_2", "4.25 - 0.125", "Pearson")
    assert good.lines() == [
        ("Map", "Accepted"),
        ("Scale", "4.25"),
        ("Offset", "-0.125"),
        ("Inliers", "90% of 120 points"),
        ("Map to points", "2.1%"),
        ("Splats to map", "4.0%"),
        ("View", "held out"),
    ]
    assert ("Compared by", "correlation (Pearson)") in bad.lines()
    assert bad.reason == "only 7 points are seen in it"
    assert report.by_view["a.jpg"].lines() == [("Map", "Missing")]


def test_the_studio_without_reading_a_map() -> None:
    """Oracle: its depth_params.json, whose maps are exact: scale 4 and offset 0 everywhere."""
    names = [path.name for path in (STUDIO / "images").iterdir()]
    report = from_table(stated_depth(STUDIO, names).table)
    assert report.counts == {ACCEPTED: 60}
    assert {row.fit for row in report.rows} == {"4 + 0"}
    assert report.rows[0].inliers is None


def test_the_report_of_a_run(tmp_path: Path) -> None:
    """Oracle: a metrics.json as a training writes it; none, one without depth, damaged ones."""
    file = tmp_path / "metrics.json"
    assert read_run_report(tmp_path) is None
    file.write_text('{"psnr": 20.0}')
    assert read_run_report(tmp_path) is None
    file.write_text(json.dumps({"depth": {"used": True, "why": "Few views.", "views": TABLE}}))
    report = read_run_report(tmp_path)
    assert report == from_table(TABLE, why="Few views.")
    for damaged in ("{", '{"depth": {"views": [3]}}', '{"depth": {"views": [{"view": "x"}]}}'):
        file.write_text(damaged)
        with pytest.raises(ValueError, match=r"expected|cannot be read"):
            read_run_report(tmp_path)


def test_row_without_values() -> None:
    """Oracle: no number is invented."""
    assert DepthRow(view="x", verdict=UNKNOWN).lines() == [("Map", "Not compared")]
    assert DepthRow(view="x", verdict=UNKNOWN).fit == "-"
