"""The cameras in the report: oracle is a scene whose places were chosen by hand."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from gscore.metrics.cameras_plan import MOST_POINTS, cameras_html, cameras_section, plan_axes
from gscore.scene import Cameras, PointCloud, Scene

RECORD = {"registered": 4, "photos": 5, "points": 3, "reprojection_px": 0.4, "alone": ["<b>.jpg"]}


def _scene(turn: np.ndarray, points: int = 200) -> Scene:
    """Four cameras on a level line of 0, 1, 2, 9 that look along +z with y down, then all turned by
    a rotation; points around (4, 0, 5), one of them far away."""
    viewmats = np.tile(np.eye(4), (4, 1, 1))
    viewmats[:, 0, 3] = [0, -1, -2, -9]
    viewmats[:, :3, :3] = viewmats[:, :3, :3] @ turn.T
    cloud = np.random.default_rng(0).normal(size=(points, 3)) * [2, 0.3, 0.3] + [4, 0, 5]
    cloud[0] = [1e5, 0, 0]
    return Scene(
        cameras=Cameras(
            viewmats=viewmats,
            Ks=np.tile(np.eye(3), (4, 1, 1)),
            widths=np.full(4, 10),
            heights=np.full(4, 10),
            names=("a.jpg", "b.jpg", "c.jpg", "d & e.jpg"),
        ),
        points=PointCloud(points=cloud @ turn.T, colors=np.full((points, 3), 200, np.uint8)),
    )


def _pictures(page: str) -> list[ElementTree.Element]:
    return [ElementTree.fromstring(svg) for svg in re.findall(r"<svg.*?</svg>", page, re.S)]


def _turn(seed: int) -> np.ndarray:
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_up_is_what_photos_call_up(seed: int) -> None:
    """Oracle: the axes of the scene before it was turned."""
    turn = _turn(seed)
    right, away, up = plan_axes(_scene(turn)) @ turn
    assert np.allclose(up, [0, -1, 0], atol=1e-9)
    assert np.allclose(abs(right), [1, 0, 0], atol=1e-9)
    assert np.allclose(np.cross(up, right), away, atol=1e-9)


def test_axes_where_cameras_have_no_up_or_one_place() -> None:
    """Oracle: three unit rows at right angles, whatever the cameras are like."""
    scene = _scene(np.eye(3))
    scene.cameras.viewmats[1::2, :2] *= -1  # every other camera on its head
    one = _scene(np.eye(3))
    one.cameras.viewmats[:, :3, 3] = 0
    for each in (scene, one):
        axes = plan_axes(each)
        assert np.allclose(axes @ axes.T, np.eye(3), atol=1e-9)


def test_pictures_show_places_to_scale(tmp_path: Path) -> None:
    """Oracle: distances along the line, 1, 1 and 7, in both pictures; far points take no room."""
    (tmp_path / "sfm.json").write_text(json.dumps(RECORD))
    section = cameras_section(tmp_path, _scene(_turn(4)))
    assert section is not None
    page = cameras_html(section)
    assert "4 of 5 photos have a camera, 3 points, mean reprojection error 0.40 px" in page
    assert "&lt;b&gt;.jpg" in page and "<b>" not in page
    pictures = _pictures(page)
    assert len(pictures) == 2
    for picture in pictures:
        wedges = picture.findall("polygon")
        assert [wedge.findtext("title") for wedge in wedges][-1] == "d & e.jpg"
        at = np.array([[float(v) for v in w.get("points", "").split()[0].split(",")]
                       for w in wedges])  # fmt: skip
        steps = np.linalg.norm(np.diff(at, axis=0), axis=1)
        assert steps[2] / steps[0] == pytest.approx(7, rel=0.02)
        assert steps.sum() > 250 and (at > 0).all() and (at < 420).all()
        assert "4 cameras, 200 points" in picture.get("aria-label", "")


def test_large_clouds_stay_small_and_none_is_no_trouble(tmp_path: Path) -> None:
    """Oracle: the number of marks, and of bytes."""
    (tmp_path / "sfm.json").write_text("{}")
    for points, most in ((50_000, MOST_POINTS), (1, 1)):
        section = cameras_section(tmp_path, _scene(np.eye(3), points))
        assert section is not None
        page = cameras_html(section)
        assert all(svg.count("h0") <= most for svg in re.findall(r"<svg.*?</svg>", page, re.S))
        assert len(page) < 150_000
    assert cameras_section(tmp_path / "none", _scene(np.eye(3))) is None
    (tmp_path / "sfm.json").write_text("[1")
    assert cameras_section(tmp_path, _scene(np.eye(3))) is None
