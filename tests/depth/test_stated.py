"""The report of depth_params.json alone on a capture's maps, against the alignment that reads
it."""

import json
import unicodedata

import numpy as np
import pytest

from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.depth import load_priors
from gscore.depth.params import key_of, read_params
from gscore.frontend import stated_depth


def _table(planes):
    return {row["view"]: row for row in stated_depth(planes.folder, planes.names).table}


def test_it_agrees_with_the_alignment(planes, gscore):
    """Oracle: `load_priors`, which reads the maps: same verdicts, reasons and scales."""
    planes.write_maps(lambda path, s: np.save(path, 2 * s))
    assert gscore("depth", planes.folder, "--quiet")[0] == 0
    file = planes.folder / "sparse" / "0" / "depth_params.json"
    params = json.loads(file.read_text())
    params["cam/v_1"]["scale"] *= 100
    params["cam/v_2"] |= {"accepted": False, "reason": "it is blue"}
    del params["cam/v_3"]
    file.write_text(json.dumps(params))
    (planes.folder / "depths" / "cam" / "v_4.npy").unlink()
    stated = stated_depth(planes.folder, planes.names)
    assert (stated.entries, stated.params, stated.problem) == (4, file, "")
    config = DataConfig(source=planes.folder, depth_align="official", resolution=1)
    rows = load_priors(config, load_dataset(config)).table
    assert [row["accepted"] for row in rows] == [True, False, False, False, False]
    for row, theirs in zip(stated.table, rows, strict=True):
        for key in ("view", "map", "accepted", "reason"):
            assert row[key] == theirs[key], key
    for key in ("scale", "offset", "inliers", "points"):
        assert stated.table[0][key] == pytest.approx(rows[0][key], rel=1e-3), key


@pytest.mark.parametrize("form", ["NFC", "NFD"])
def test_names_are_compared_in_one_form_of_unicode(form, tmp_path):
    """Oracle: the entry of a view with an accented letter in the other form."""
    other = {"NFC": "NFD", "NFD": "NFC"}[form]
    key = unicodedata.normalize(form, "k\u00fcche/1")
    file = tmp_path / "depth_params.json"
    file.write_text(json.dumps({key: {"scale": 2.0, "offset": 0.5}}))
    view = unicodedata.normalize(other, "k\u00fcche/1.jpg")
    assert read_params(file)[key_of(view)].scale == 2.0
    assert key_of(view) == key_of(unicodedata.normalize(form, view))


def test_no_verdict_without_maps(planes):
    """Oracle: no verdict on maps without a file; a refusal without maps."""
    assert {row["accepted"] for row in _table(planes).values()} == {False}
    planes.write_maps(lambda path, s: np.save(path, s))
    rows = _table(planes)
    assert {row["accepted"] for row in rows.values()} == {None}
    assert rows["cam/v_0.png"]["map"] == "v_0.npy" and rows["cam/v_0.png"]["scale"] is None


@pytest.mark.parametrize("text", ["{", "[]", '{"cam/v_0": 3}', '{"cam/v_0": {"scale": "x"}}'])
def test_a_broken_file_is_a_problem_not_an_error(planes, text):
    """Oracle: the sentence, which names the file."""
    planes.write_maps(lambda path, s: np.save(path, s))
    (planes.folder / "sparse" / "0" / "depth_params.json").write_text(text)
    stated = stated_depth(planes.folder, planes.names)
    assert "depth_params.json" in stated.problem and stated.entries == 0
    assert {row["accepted"] for row in stated.table} == {None}


def test_files_of_official_tools(planes):
    """Oracle: two keys alone: a verdict by their rule, and no other numbers."""
    planes.write_maps(lambda path, s: np.save(path, s))
    entries = {f"cam/v_{i}": {"scale": 1.0 + i, "offset": 0.5} for i in range(4)}
    entries["cam/v_4"] = {"scale": 0.0, "offset": 0.0}
    (planes.folder / "sparse" / "0" / "depth_params.json").write_text(json.dumps(entries))
    rows = list(_table(planes).values())
    assert [row["accepted"] for row in rows] == [True, True, True, True, False]
    assert (rows[1]["scale"], rows[1]["offset"], rows[1]["inliers"]) == (2.0, 0.5, None)
