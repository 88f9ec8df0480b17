"""Captures that are small in their own units: the near plane of the training, in every verb."""

import json

import numpy as np
import pytest

from gscore.io.images.read_image import read_image
from gscore.lod.lod_renderer import LodModel

from .conftest import STEPS
from .test_far_captures import moved, psnr

TRAIN = (
    *("--preset", "draft", "--iterations", STEPS, "--eval", "--quiet", "--threads", 1),
    *("--exposure", "off"),  # a file of splats has no gains
)
SMALL = 1e-4


@pytest.fixture(scope="module", params=[(0.0, 0.0, 0.0), (5.0, 3.0, -2.0)])
def small(request, capture, tmp_path_factory):
    """The capture, 10,000 times smaller."""
    folder = tmp_path_factory.mktemp("small") / "capture"
    return moved(capture, folder, np.array(request.param), SMALL)


@pytest.fixture
def run(gscore, small, tmp_path):
    """A training on it."""
    assert gscore("train", small, "-o", tmp_path / "run", *TRAIN)[0] == 0
    return tmp_path / "run"


def measured(gscore, model, small, folder):
    """PSNR of a file of splats on the photos."""
    assert gscore("eval", model, "-s", small, "-o", folder, "--split", "test", "--quiet")[0] == 0
    return psnr(folder)


def test_written_file_has_the_reported_psnr(gscore, run, small, trained, tmp_path):
    """Oracle: PSNR of the run at the capture's usual size, and of the small run itself."""
    said = psnr(run)
    assert said == pytest.approx(psnr(trained), abs=0.1)
    assert measured(gscore, run, small, tmp_path / "again") == pytest.approx(said, abs=1e-3)
    alone = tmp_path / "alone.ply"
    alone.write_bytes((run / "point_cloud.ply").read_bytes())
    assert measured(gscore, alone, small, tmp_path / "of_file") == pytest.approx(said, abs=1e-3)


def test_converted_files_measure_so_too(gscore, run, small, tmp_path):
    """Oracle: PSNR of the run; a PLY states the near plane, a .splat has no field for it."""
    said = psnr(run)
    for name in ("of.ply", "of.splat"):
        assert gscore("convert", run, tmp_path / name)[0] == 0
    of_ply, of_splat = (
        measured(gscore, tmp_path / name, small, tmp_path / name.replace(".", "_"))
        for name in ("of.ply", "of.splat")
    )
    assert of_ply == pytest.approx(said, abs=1e-3)
    assert of_splat == pytest.approx(said, abs=1.5)


def test_render_and_levels_of_detail_draw_what_the_photos_show(gscore, run, small, tmp_path):
    """Oracle: the photo; within the error of the training, unlike the background."""
    photo = read_image(small / "images/a_0.png") / 255
    lod = tmp_path / "model.lod"
    assert gscore("lod", run, "-o", lod)[0] == 0
    for model in (run, lod):
        out = tmp_path / f"of_{model.stem}"
        assert gscore("render", model, "-s", small, "-o", out, "--quiet")[0] == 0
        shown = read_image(next(out.rglob("*a_0*"))) / 255
        assert np.abs(shown - photo).mean() < 0.5 * photo.mean()
    assert LodModel(lod).index.near < 1e-4


def test_a_scaled_model_scales_its_near_plane(gscore, run, tmp_path):
    """Oracle: the header's number times the factor."""

    def near(path):
        head = path.read_bytes()[:2000].decode("ascii", "replace")
        return float(head.split("gscore near ")[1].split("\n")[0])

    assert gscore("convert", run, tmp_path / "x.ply", "--scale", 100)[0] == 0
    assert near(tmp_path / "x.ply") == pytest.approx(100 * near(run / "point_cloud.ply"))


def test_ordinary_captures_state_none(trained):
    """Oracle: the header as known to other readers."""
    head = (trained / "point_cloud.ply").read_bytes()[:2000]
    assert b"gscore near" not in head and json.loads((trained / "config.json").read_text())
