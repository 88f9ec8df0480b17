"""cameras.json against the layout that the official code writes."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gscore.errors import FormatError, GsError
from gscore.io.cameras_json import read_cameras_json, write_cameras
from gscore.scene import Cameras


@pytest.fixture
def cameras(rng: np.random.Generator) -> Cameras:
    viewmats = np.tile(np.eye(4), (3, 1, 1))
    viewmats[:, :3, :3] = Rotation.random(3, rng=rng).as_matrix()
    viewmats[:, :3, 3] = rng.normal(0, 4, (3, 3))
    Ks = np.tile(np.eye(3), (3, 1, 1))
    Ks[:, [0, 1, 0, 1], [0, 1, 2, 2]] = rng.uniform(100, 900, (3, 4))
    return Cameras(
        viewmats=viewmats,
        Ks=Ks,
        widths=np.array([640, 800, 33]),
        heights=np.array([480, 600, 44]),
        names=("a.jpg", "sub/b.jpg", "ü.png"),
    )


def test_official_layout(cameras: Cameras, tmp_path: Path) -> None:
    """Oracle: position and rotation of the inverted world-to-camera matrix."""
    write_cameras(tmp_path / "cameras.json", cameras)
    entries = json.loads((tmp_path / "cameras.json").read_text())
    assert [entry["id"] for entry in entries] == [0, 1, 2]
    for i, entry in enumerate(entries):
        inverse = np.linalg.inv(cameras.viewmats[i])
        np.testing.assert_allclose(entry["position"], inverse[:3, 3], atol=1e-12)
        np.testing.assert_allclose(entry["rotation"], inverse[:3, :3], atol=1e-12)
        assert entry["img_name"] == cameras.names[i]
        assert (entry["width"], entry["height"]) == (cameras.widths[i], cameras.heights[i])
        K = cameras.Ks[i]
        assert [entry[k] for k in ("fx", "fy", "cx", "cy")] == [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]


def test_round_trip(cameras: Cameras, tmp_path: Path) -> None:
    """Oracle: the written cameras."""
    write_cameras(tmp_path / "cameras.json", cameras)
    again = read_cameras_json(tmp_path / "cameras.json")
    np.testing.assert_allclose(again.viewmats, cameras.viewmats, atol=1e-12)
    np.testing.assert_array_equal(again.Ks, cameras.Ks)
    np.testing.assert_array_equal(again.widths, cameras.widths)
    assert again.names == cameras.names


def test_up_is_kept_where_it_is_known(cameras: Cameras, tmp_path: Path) -> None:
    """Oracle: the written direction; none from files of other programs; a wrong one is refused."""
    path, up = tmp_path / "cameras.json", np.array([0.0, 0.6, 0.8])
    write_cameras(path, cameras)
    assert read_cameras_json(path).up is None and "up" not in path.read_text()
    write_cameras(path, replace(cameras, up=up))
    np.testing.assert_allclose(read_cameras_json(path).up, up)
    path.write_text(path.read_text().replace("[0.0, 0.6, 0.8]", "[0.0, 0.0, 0.0]"))
    with pytest.raises(FormatError, match="camera 0 has no valid up"):
        read_cameras_json(path)


def test_official_files_have_no_principal_point(cameras: Cameras, tmp_path: Path) -> None:
    """Oracle: the centre of the picture."""
    write_cameras(tmp_path / "cameras.json", cameras)
    entries = json.loads((tmp_path / "cameras.json").read_text())
    for entry in entries:
        del entry["cx"], entry["cy"]
    (tmp_path / "cameras.json").write_text(json.dumps(entries))
    again = read_cameras_json(tmp_path / "cameras.json")
    np.testing.assert_array_equal(again.Ks[:, 0, 2], cameras.widths / 2)
    np.testing.assert_array_equal(again.Ks[:, 1, 2], cameras.heights / 2)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("width", "wide"),
        ("width", 0),
        ("height", 4.5),
        ("position", [1, 2]),
        ("position", [1, 2, "x"]),
        ("rotation", [[1, 0, 0], [0, 2, 0], [0, 0, 1]]),
        ("rotation", [[1, 0, 0], [0, 1, 0], [0, 0, -1]]),
        ("position", [1, 1e300, 2]),
        ("rotation", [[1, 0, 0], [0, 1e300, 0], [0, 0, 1]]),
        ("fx", None),
        ("fy", [1]),
        ("fx", 0),
        ("fx", -60.0),
        ("fx", 1e-30),
        ("fy", 1e29),
        ("fy", float("nan")),
        ("img_name", 3),
        ("cx", float("nan")),
    ],
)
def test_unusable_entries(key: str, value: object, cameras: Cameras, tmp_path: Path) -> None:
    """Oracle: the sentence, with file, camera and key; likewise for a missing key."""
    write_cameras(tmp_path / "cameras.json", cameras)
    entries = json.loads((tmp_path / "cameras.json").read_text())
    entries[1][key] = value
    (tmp_path / "cameras.json").write_text(json.dumps(entries))
    with pytest.raises(FormatError, match=rf"cameras\.json: camera 1 has no valid .*{key}"):
        read_cameras_json(tmp_path / "cameras.json")
    if key not in ("cx", "cy"):
        del entries[1][key]
        (tmp_path / "cameras.json").write_text(json.dumps(entries))
        with pytest.raises(FormatError, match=rf"camera 1 has no valid '{key}'"):
            read_cameras_json(tmp_path / "cameras.json")


def test_hostile(cameras: Cameras, mutations: Callable, tmp_path: Path) -> None:
    """Oracle: cameras or one of our errors, for a damaged file; no other exception."""
    path, refused = tmp_path / "cameras.json", 0
    write_cameras(path, cameras)
    for raw in [*mutations(path.read_bytes()), b"{}", b"[1]", b"[[]]", b"null", b"[" * 9999]:
        path.write_bytes(raw)
        try:
            read_cameras_json(path)
        except GsError as error:
            assert "cameras.json" in str(error)
            refused += 1
    assert refused > 20
