"""depth_params.json as official tools read it, and every error in one."""

import json

import pytest

from gscore.depth.fit import NO_FIT, Fit
from gscore.depth.maps import DepthKind
from gscore.depth.params import params_path, read_params, write_params
from gscore.errors import DatasetError, FormatError, GsError

GOOD = Fit(scale=1.5, offset=-0.25, inliers=0.9, points=321, error=0.0123, accepted=True)


def test_written_as_official_tools_read_it(tmp_path):
    """Oracle: the official loader's steps: scale and offset of every entry, median of positives."""
    path = tmp_path / "depth_params.json"
    fits = {
        "a/b_001": GOOD,
        "ü": Fit(scale=9.0, offset=1.0, points=50).refused("it is far off"),
        "c": NO_FIT.refused("only 3 points are seen in it, expected 20"),
    }
    write_params(path, fits, DepthKind.INVERSE)
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["a/b_001"]["scale"] == 1.5 and content["a/b_001"]["offset"] == -0.25
    scales = [entry["scale"] for entry in content.values()]
    positive = sorted(s for s in scales if s > 0)
    assert positive == [1.5]  # refused views have the scale 0, below 0.2 times the median
    assert content["ü"]["reason"] == "it is far off" and content["c"]["error"] is None
    back = read_params(path)
    assert back["a/b_001"].accepted and back["a/b_001"].scale == 1.5
    assert not back["c"].accepted and "3 points" in back["c"].reason


def test_round_trip_is_exact(tmp_path):
    """Oracle: equality of float64 numbers."""
    path = tmp_path / "sub" / "depth_params.json"
    fit = Fit(scale=1 / 3, offset=-2e-17, points=50, accepted=True)
    write_params(path, {"x": fit}, DepthKind.DEPTH)
    back = read_params(path)["x"]
    assert (back.scale, back.offset, back.kind) == (1 / 3, -2e-17, DepthKind.DEPTH)


def test_files_of_official_tools(tmp_path):
    """Oracle: the two keys of those tools, and the third of some."""
    path = tmp_path / "depth_params.json"
    path.write_text(
        '{"x": {"scale": 2, "offset": 0}, "y": {"scale": 0, "offset": 0, "med_scale": 2}}'
    )
    back = read_params(path)
    assert back["x"].scale == 2.0 and back["x"].kind is DepthKind.INVERSE and back["y"].scale == 0


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "not JSON"),
        ('{"x": {"scale": 1', "not JSON"),
        ("\x00\xff", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("[]", "expected an object"),
        ("3", "expected an object"),
        ('{"x": 3}', "expected an object"),
        ('{"x": {"offset": 1}}', "x: scale is missing"),
        ('{"x": {"scale": 1}}', "x: offset is missing"),
        ('{"x": {"scale": "1", "offset": 0}}', "x: scale is '1'"),
        ('{"x": {"scale": true, "offset": 0}}', "x: scale is True"),
        ('{"x": {"scale": NaN, "offset": 0}}', "x: scale is nan"),
        ('{"x": {"scale": 1, "offset": Infinity}}', "x: offset is inf"),
        ('{"x": {"scale": 1, "offset": 0, "kind": "disparity"}}', "kind is 'disparity'"),
    ],
)
def test_broken_files(tmp_path, text, word):
    """Oracle: an error with the file, the fault and the command that repairs it."""
    path = tmp_path / "depth_params.json"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(FormatError) as caught:
        read_params(path)
    message = str(caught.value)
    assert str(path) in message and word in message and "gscore depth" in message


@pytest.mark.parametrize(
    "content",
    [
        {"depth_map": "a.png", "camera": "1", "depth_scale": 1000},
        [{"depth_map": "a.png", "camera": {"fx": 1}, "depth_scale": 1000}],
        {"a": {"depth_map": "a.png", "camera": 1, "depth_scale": 0.001}},
    ],
)
def test_the_other_layout_is_refused_with_the_reason(tmp_path, content):
    """Oracle: the error, with the layout and the reason against it."""
    path = tmp_path / "depth_params.json"
    path.write_text(json.dumps(content))
    with pytest.raises(DatasetError, match=r"camera and depth_scale.*expected scale and offset"):
        read_params(path)


def test_missing_file(tmp_path):
    """Oracle: the error, with the file and the command that makes it."""
    with pytest.raises(DatasetError, match=r"There is no .*depth_params\.json.*gscore depth"):
        read_params(tmp_path / "depth_params.json")


def test_writing_leaves_the_old_file_alone_on_failure(tmp_path):
    """Oracle: the previous bytes, and no temporary file."""
    folder = tmp_path / "sparse"
    folder.mkdir()
    path = folder / "depth_params.json"
    path.write_text("old")
    with pytest.raises(ValueError):  # NaN is not valid JSON
        write_params(
            path, {"x": Fit(scale=float("nan"), offset=0.0, accepted=True)}, DepthKind.AUTO
        )
    assert path.read_text() == "old" and [p.name for p in folder.iterdir()] == [path.name]
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(GsError, match="Cannot write"):
        write_params(blocked / "depth_params.json", {"x": GOOD}, DepthKind.INVERSE)


def test_params_path(tmp_path):
    """Oracle: sparse/0 for depths, as in official tools; a folder of another name has its own."""
    depths, other = tmp_path / "depths", tmp_path / "depths_b"
    assert params_path(tmp_path, depths) == tmp_path / "depth_params.json"
    sparse = tmp_path / "sparse"
    sparse.mkdir()
    for name in ("cameras.txt", "images.txt"):
        (sparse / name).write_text("")
    assert params_path(tmp_path, depths) == sparse / "depth_params.json"
    official = sparse / "0" / "depth_params.json"
    official.parent.mkdir()
    official.write_text("{}")
    assert params_path(tmp_path, depths, writing=True) == official
    assert params_path(tmp_path, other) == official
    assert params_path(tmp_path, other, writing=True) == other / "depth_params.json"
    other.mkdir()
    (other / "depth_params.json").write_text("{}")
    assert params_path(tmp_path, other) == other / "depth_params.json"
