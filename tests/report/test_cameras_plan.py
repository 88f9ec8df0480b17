"""The cameras in the report: oracle is a scene whose places were chosen by hand."""

import dataclasses
import json
import math
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from gscore.report.cameras_plan import cameras_html, cameras_section
from gscore.report.plan import MOST_POINTS, plan_axes
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


def test_up_is_what_the_capture_states() -> None:
    """Oracle: a stated up that the photos do not have in common, in a scene that was turned."""
    turn = _turn(5)
    scene = _scene(turn)
    stated = turn @ [0, -math.cos(1.2), math.sin(1.2)]
    cameras = dataclasses.replace(scene.cameras, up=stated)
    assert np.allclose(plan_axes(dataclasses.replace(scene, cameras=cameras))[2], stated)


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
    page = cameras_html(cameras_section(tmp_path, _scene(_turn(4))), {})
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
        page = cameras_html(cameras_section(tmp_path, _scene(np.eye(3), points)), {})
        assert all(svg.count("h0") <= most for svg in re.findall(r"<svg.*?</svg>", page, re.S))
        assert len(page) < 150_000


def test_without_a_record_nobody_is_said_to_have_searched(tmp_path: Path) -> None:
    """Oracle: the page; a record that cannot be read is none."""
    (tmp_path / "sfm.json").write_text("[1")
    for folder in (tmp_path / "none", tmp_path):
        page = cameras_html(cameras_section(folder, _scene(np.eye(3))), {})
        assert "Found by gscore" not in page and page.count("<polygon") == 8
        assert "dB" not in page and "scored" not in page


def test_colours_go_from_the_worst_to_the_best(tmp_path: Path) -> None:
    """Oracle: ranks by hand; scored cameras are drawn last and tell their number."""
    worths = {"a.jpg": 31.5, "b.jpg": 20.0, "c.jpg": 25.75, "d & e.jpg": None}
    page = cameras_html(cameras_section(tmp_path, _scene(np.eye(3))), worths)
    assert "20.0 dB" in page and "31.5 dB" in page
    for picture in _pictures(page):
        wedges = picture.findall("polygon")
        titles = [wedge.findtext("title") for wedge in wedges]
        assert titles == ["d & e.jpg", "a.jpg: 31.50 dB", "b.jpg: 20.00 dB", "c.jpg: 25.75 dB"]
        colors = [wedge.get("style") for wedge in wedges]
        assert colors == [None, "fill:#1f5fb0", "fill:#b2182b", "fill:#a9a9a9"]
    same = cameras_html(cameras_section(tmp_path, _scene(np.eye(3))), {"a.jpg": 30.0})
    assert same.count("fill:#1f5fb0") == 2


def test_most_cameras_are_left_out_but_none_with_a_number(tmp_path: Path) -> None:
    """Oracle: the number of wedges."""
    scene = _scene(np.eye(3))
    many = 5000
    cameras = Cameras(
        viewmats=np.tile(scene.cameras.viewmats, (many // 4, 1, 1)),
        Ks=np.tile(np.eye(3), (many, 1, 1)),
        widths=np.full(many, 10),
        heights=np.full(many, 10),
        names=tuple(f"{i}.jpg" for i in range(many)),
    )
    worths = {f"{i}.jpg": float(i) for i in range(0, many, 2)}
    page = cameras_html(
        cameras_section(tmp_path, Scene(cameras=cameras, points=scene.points)), worths
    )
    assert page.count("wedge scored") == 2 * len(worths)
    assert 2 * 500 < page.count('class="wedge"') <= 2 * 1000
