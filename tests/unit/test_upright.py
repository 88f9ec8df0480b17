"""The up direction by cameras and EXIF orientations, for all its users."""

import base64
import json
import sys
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from gscore.blocks.split_capture import cut_capture
from gscore.commands import main
from gscore.commands.args.model_argument import ModelArgument
from gscore.commands.pictures.page_views import find_views
from gscore.commands.pictures.render_cameras import find_shots
from gscore.commands.terminal.status import Status
from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.io.images.read_image import read_image
from gscore.report.plan import plan_axes
from gscore.scene import Cameras
from gscore.upright import turn_cameras, up_axis, upright_turns

from ..mesh.shapes import around
from ..upright_photos import SIZE, upright_capture

HELD = {
    **{str(turn): (turn,) * 12 for turn in range(1, 9)},
    "portrait and landscape": (6, 6, 6, 1) * 3,
    "both ways": (1, 3) * 6,
    "all four": (1, 3, 6, 8) * 3,
    "portraits on either side": (6, 8) * 6,
    "mirrored in two ways": (5, 7) * 6,
}
"""EXIF orientations of photos of captures."""


def degrees(a: np.ndarray | None, b: np.ndarray) -> float:
    """Angle between unit vectors, the largest over the rows of `a`."""
    assert a is not None
    return float(np.degrees(np.arccos(np.clip(a @ b, -1, 1))).max())


def cameras_of(folder: Path) -> Cameras:
    """Cameras as in a training."""
    return load_dataset(DataConfig(source=folder)).scene.cameras


@pytest.mark.parametrize("held", HELD)
def test_up_is_as_the_photos_were_held(held: str, tmp_path: Path) -> None:
    """Oracle: the vertical of the world in which all photos were level, in the dataset, the plan of
    the report and blocks."""
    up = upright_capture(tmp_path / "walk", HELD[held])
    scene = load_dataset(DataConfig(source=tmp_path / "walk")).scene
    cut = cut_capture(DataConfig(source=tmp_path / "walk"), 2)
    if set(HELD[held]) == {1}:  # unchanged files of ordinary captures
        assert scene.cameras.up is None and cut.model.up is None
    else:
        assert degrees(scene.cameras.up, up) < 0.1 and degrees(cut.model.up, up) < 0.1
    assert degrees(plan_axes(scene)[2], up) < 0.1


@pytest.mark.parametrize("path", ["orbit", "spline"])
@pytest.mark.parametrize("held", HELD)
def test_videos_stand_upright(held: str, path: str, tmp_path: Path) -> None:
    """Oracle: the vertical again, for level cameras that face down by up to 34 degrees, and a
    picture like most photos, neither stretched nor on its side."""
    up = upright_capture(tmp_path, HELD[held])
    shots = find_shots(_asked(tmp_path, path=path), _no_model(), is_video=False)
    tops = -shots.cameras.viewmats[:, 1, :3]
    assert degrees(tops, up) < 35
    rights = shots.cameras.viewmats[:, 0, :3]
    assert np.abs(rights @ up).max() < 0.05
    np.testing.assert_allclose(shots.cameras.Ks[:, 0, 0], shots.cameras.Ks[:, 1, 1])
    portraits = sum(turn >= 5 for turn in HELD[held])
    if portraits != 6:
        wide = shots.cameras.widths[0] > shots.cameras.heights[0]
        assert wide == (portraits < 6)


@pytest.mark.parametrize("held", HELD)
def test_pages_show_views_and_photos_upright(held: str, tmp_path: Path) -> None:
    """Oracle: the vertical, and the upper half of each photo, which is white."""
    up = upright_capture(tmp_path, HELD[held])
    views = find_views(_asked(tmp_path, photos=12), _no_model(), Status(sys.stderr, quiet=True))
    assert degrees(views.up, up) < 0.1
    for camera in views.cameras:
        assert degrees(-camera.viewmat[1, :3], up) < 35
        shown = _photo(camera.photo, tmp_path)
        assert shown[: len(shown) // 3].mean() > 240 and shown[-len(shown) // 3 :].mean() < 15
        assert (camera.width > camera.height) == (shown.shape[1] > shown.shape[0])


def test_a_run_and_its_cameras_keep_up(tmp_path: Path) -> None:
    """Oracle: the vertical, in cameras.json, from which an orbit is made without the capture."""
    up = upright_capture(tmp_path / "walk", (6, 8, 3) * 4)
    arguments = ["--iterations", "2", "--preset", "preview", "--threads", "1", "--quiet"]
    assert main(["train", str(tmp_path / "walk"), "-o", str(tmp_path / "run"), *arguments]) == 0
    reported = json.loads((tmp_path / "run/cameras.json").read_text())
    assert degrees(np.array(reported[0]["up"]), up) < 0.1


def test_turned_cameras_see_the_turned_picture() -> None:
    """Oracle: projections of points, in rows and columns as numpy turns them."""
    rng = np.random.default_rng(1)
    K = np.array([[50.0, 0, 20.0], [0, 60.0, 15.0], [0, 0, 1]])
    count = 4
    cameras = Cameras(
        viewmats=np.tile(np.eye(4), (count, 1, 1)), Ks=np.tile(K, (count, 1, 1)),
        widths=np.full(count, SIZE[0]), heights=np.full(count, SIZE[1]),
        names=tuple("abcd"),
    )  # fmt: skip
    turns = np.arange(count)
    turned = turn_cameras(cameras, turns)
    for i in range(count):
        row, column = rng.integers(0, SIZE[1]), rng.integers(0, SIZE[0])
        picture = np.zeros((SIZE[1], SIZE[0]))
        picture[row, column] = 1
        [there] = np.argwhere(np.rot90(picture, i))
        point = np.linalg.inv(K) @ [column + 0.5, row + 0.5, 1]
        x, y, z = turned.Ks[i] @ turned.viewmats[i, :3, :3] @ point
        np.testing.assert_allclose((y / z, x / z), there + 0.5)
        assert np.rot90(picture, i).shape == (turned.heights[i], turned.widths[i])
    back = turn_cameras(turned, -turns % 4)
    np.testing.assert_allclose(back.viewmats, cameras.viewmats)
    np.testing.assert_allclose(back.Ks, cameras.Ks)


def test_pictures_taken_straight_down_turn_like_the_one_before(tmp_path: Path) -> None:
    """Oracle: a portrait, one straight down, one upright, one straight down; none at all."""
    upright_capture(tmp_path, (6, 6, 1, 1) * 3)
    cameras = cameras_of(tmp_path)
    for i in (1, 3):
        cameras.viewmats[i, :3, :3] = np.roll(np.eye(3), i, axis=0) @ _down(cameras.up)
    assert upright_turns(cameras)[:4].tolist() == [3, 3, 0, 0]
    cameras.viewmats[:, :3, :3] = _down(cameras.up)
    assert not upright_turns(cameras).any()


def _down(up: np.ndarray | None) -> np.ndarray:
    """[3, 3] a rotation, world to camera, that faces down."""
    assert up is not None
    x = np.cross(up, [1.0, 0, 0])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(-up, x), -up])


def _no_model() -> ModelArgument:
    """A model of a capture that is named."""
    about = SimpleNamespace(of_capture=lambda origin: SimpleNamespace(origin=origin))
    return ModelArgument(run=None, file=cast(Any, about), data=None, train=None)


def _asked(folder: Path, **others: object) -> Namespace:
    """The options of a user."""
    usual = {"cameras": folder, "source": folder, "resolution": 1.0, "path": "", "test": False}
    usual |= {"view": None, "all": False, "frames": 24, "fps": None, "photos": 0}
    return Namespace(**usual | others)


def _photo(uri: str, folder: Path) -> np.ndarray:
    """[H, W, 3] the picture of a data: URI."""
    path = folder / "shown.jpg"
    path.write_bytes(base64.b64decode(uri.split(",", 1)[1]))
    return read_image(path)


@pytest.mark.parametrize(("tilt", "axis"), [(0, "Z"), (10, "Z"), (30, ""), (90, "Y"), (180, "-Z")])
def test_the_axis_that_is_up(tilt: float, axis: str) -> None:
    """Oracle: level cameras in a world with z up, tilted about x from z to y."""
    turn = np.eye(4)
    c, s = np.cos(np.radians(tilt)), np.sin(np.radians(tilt))
    turn[1:3, 1:3] = [[c, s], [-s, c]]
    cameras = around(12, least=0.3)
    cameras = replace(cameras, viewmats=cameras.viewmats @ np.linalg.inv(turn))
    assert up_axis(cameras) == axis
    assert up_axis(replace(cameras, up=np.array([-1.0, 0, 0]))) == "-X"
