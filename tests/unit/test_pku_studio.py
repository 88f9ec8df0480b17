"""The studio capture under the names of PKU-DyMVHumans: real photos, real SfM, known cameras."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gscore.config import DataConfig
from gscore.datasets import load_dataset, read_capture
from gscore.io.colmap.folder import read_model, write_model

STUDIO = Path(__file__).parent.parent.parent / "examples" / "studio"


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`data_COLMAP/000000` with the model of the studio, `per_frame/000000` with true `cams`."""
    root = tmp_path_factory.mktemp("studio") / "480_Stand_Single_f01"
    model = read_model(STUDIO)
    truth = json.loads((STUDIO / "cameras_true.json").read_text())
    true = {view["name"]: view["viewmat"] for view in truth["views"]}
    colmap, single = root / "data_COLMAP/000000", root / "per_frame/000000"
    for folder in (colmap / "images", colmap / "masks", single / "images", single / "pha"):
        folder.mkdir(parents=True)
    (root / "cams").mkdir()
    images = []
    for number, image in enumerate(sorted(model.images, key=lambda image: image.name)):
        name = f"image_c_{number:03d}_f_000000.jpg"
        images.append(replace(image, name=name))
        photo, matte = STUDIO / "images" / image.name, STUDIO / "masks" / image.name
        for target in (colmap / "images" / name, single / "images" / name):
            target.symlink_to(photo)
        for target in (colmap / "masks" / name, single / f"pha/pha_c_{number:03d}_f_000000"):
            target.with_suffix(".png").symlink_to(matte.with_suffix(".png"))
        text = ["extrinsic", *(" ".join(map(str, row)) for row in true[image.name])]
        text += ["", "intrinsic", *(" ".join(map(str, row)) for row in truth["K"])]
        (root / f"cams/{number:08d}_cam.txt").write_text("\n".join([*text, "", "1 0.01 192 5"]))
    write_model(replace(model, images=images), colmap / "sparse")
    return root


def test_the_frame_is_the_capture_under_other_names(case: Path) -> None:
    """Oracle: our COLMAP reader on the studio itself."""
    plain = load_dataset(DataConfig(source=STUDIO, resolution=4, mask_mode="composite"))
    frame = load_dataset(DataConfig(source=case, resolution=4))
    assert frame.mask_mode == "composite"
    for name in ("viewmats", "Ks", "widths", "heights"):
        a, b = (getattr(dataset.scene.cameras, name) for dataset in (plain, frame))
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(plain.scene.points.points, frame.scene.points.points)
    for i in (0, 31):
        np.testing.assert_array_equal(plain.image(i), frame.image(i))
        np.testing.assert_array_equal(plain.mask(i), frame.mask(i))


def test_cams_are_the_true_cameras(case: Path) -> None:
    """Oracle: cameras_true.json, with a median distance of 2.3 mm from the model."""
    capture = read_capture(DataConfig(source=case / "per_frame"))
    truth = json.loads((STUDIO / "cameras_true.json").read_text())
    for view, true in zip(capture.views, truth["views"], strict=True):
        np.testing.assert_allclose(view.viewmat, true["viewmat"], atol=1e-8)
        np.testing.assert_array_equal(view.camera.K, truth["K"])
        assert view.mask is not None
    model = read_capture(DataConfig(source=case / "data_COLMAP"))
    places = [
        {view.name: np.linalg.inv(view.viewmat)[:3, 3] for view in part.views}
        for part in (capture, model)
    ]
    off = [np.linalg.norm(places[0][name] - places[1][name]) for name in places[0]]
    assert 0.001 < np.median(off) < 0.003


def test_fifty_cameras_train_and_ten_test(case: Path) -> None:
    """Oracle: the camera numbers of the study's split."""
    dataset = load_dataset(DataConfig(source=case, eval=True, test_last=10))
    assert dataset.train == list(range(50))
    assert [dataset.names[i] for i in dataset.test] == [
        f"image_c_{number:03d}_f_000000.jpg" for number in range(50, 60)
    ]


def test_the_rig_may_be_the_true_one(case: Path) -> None:
    """Oracle: the points of SfM, which are in metres already and hardly move."""
    true = read_capture(DataConfig(source=case / "per_frame"))
    own = read_capture(DataConfig(source=case / "data_COLMAP"))
    joined = read_capture(DataConfig(source=case / "data_COLMAP", rig=case / "per_frame"))
    places = {view.name: view.viewmat for view in true.views}
    for view in joined.views:
        np.testing.assert_array_equal(view.viewmat, places[view.name])
    moved = np.linalg.norm(joined.points.points - own.points.points, axis=1)
    near = np.linalg.norm(own.points.points, axis=1) < 2
    assert 0 < np.median(moved[near]) < 0.003
