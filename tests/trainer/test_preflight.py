"""Preflight checks of a training; oracle: captures damaged by hand."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gscore.config import TrainConfig
from gscore.errors import DatasetError
from gscore.formats import write_splat_file
from gscore.scene import PointCloud
from gscore.splats import Splats
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.preflight import check_training
from gscore.trainer.region.region_photos import RegionBox
from gscore.trainer.trainer import Trainer

pytestmark = pytest.mark.usefixtures("fake_engine")

CONFIG = TrainConfig(iterations=10, max_splats=500, sh_degree=0)


def warnings(photos: Any) -> list[str]:
    return check_training(Trainer(CONFIG, Analysis(photos=photos)))


def with_points(photos: Any, points: np.ndarray) -> Any:
    cloud = PointCloud(points=points, colors=photos.scene.points.colors)
    return replace(photos, scene=replace(photos.scene, points=cloud))


def test_a_sound_capture_has_no_warning(photos: Any) -> None:
    """Oracle: no warnings."""
    assert warnings(photos) == []


@pytest.mark.parametrize(("degree", "reported"), [(4, 1), (3, 0)])
def test_higher_sh_degree_of_start_splats_warns(photos: Any, degree: int, reported: int) -> None:
    """Oracle: the degrees; the splats are otherwise the points of the capture."""
    config = replace(CONFIG, sh_degree=3)
    count, rest = 50, (degree + 1) ** 2 - 1
    start = Splats(
        means=photos.scene.points.points[:count].astype(np.float32),
        quats=np.ones((count, 4), np.float32),
        scales=np.full((count, 3), -3, np.float32),
        opacities=np.zeros(count, np.float32),
        sh0=np.zeros((count, 1, 3), np.float32),
        shN=np.ones((count, rest, 3), np.float32),
    )
    trainer = Trainer(config, Analysis(photos=photos, start=start))
    assert trainer.model.params["shN"].shape[1] == 15
    assert [sentence for sentence in check_training(trainer) if "have SH degree 4" in sentence] == [
        sentence
        for sentence in check_training(trainer)
        if "view dependence of higher degrees is lost" in sentence
    ]
    assert sum("SH degree" in sentence for sentence in check_training(trainer)) == reported


@pytest.mark.usefixtures("real_engine")
@pytest.mark.parametrize("strange", [False, True])
def test_start_splats_of_another_scene_warn(
    photos: Any, known_splats: Splats, tmp_path: Path, strange: bool
) -> None:
    """Oracle: the photos; the same with inverted colours."""
    start = replace(known_splats, sh0=-3 * known_splats.sh0) if strange else known_splats
    write_splat_file(tmp_path / "a.ply", start)
    config = replace(CONFIG, start_splats=tmp_path / "a.ply", sh_degree=1)
    trainer = Trainer(config, Analysis(photos=photos, start=start))
    reported = [text for text in check_training(trainer) if "Are they of this capture" in text]
    assert len(reported) == strange


@pytest.mark.parametrize("count", [99, 100])
def test_nearly_empty_region_warns(
    photos: Any, known_splats: Splats, tmp_path: Path, count: int
) -> None:
    """Oracle: the number of splats."""
    start = known_splats.subset(np.arange(count))
    write_splat_file(tmp_path / "a.ply", start)
    given = {"start_splats": tmp_path / "a.ply", "region": tmp_path / "r.json", "sh_degree": 1}
    trainer = Trainer(
        replace(CONFIG, **given),
        Analysis(photos=photos, start=start, region=RegionBox(10 * np.eye(4))),
    )
    reported = [text for text in check_training(trainer) if "are in the region" in text]
    assert len(reported) == (count < 100)


@pytest.mark.usefixtures("real_engine")
def test_points_that_no_view_shows_are_an_error(photos: Any) -> None:
    """Oracle: all points shifted by 1e4."""
    aside = photos.scene.points.points + np.array([0.0, 1e4, 0.0])
    with pytest.raises(DatasetError, match=r"None of the \d+ training views shows any"):
        warnings(with_points(photos, aside))


@pytest.mark.usefixtures("real_engine")
def test_a_view_that_looks_away_is_named(photos: Any) -> None:
    """Oracle: one camera turned round; the points are in the other views."""
    cameras = photos.scene.cameras
    viewmats = cameras.viewmats.copy()
    index = photos.train[2]
    viewmats[index] = np.diag([-1.0, 1.0, -1.0, 1.0]) @ viewmats[index]
    turned = replace(photos.scene, cameras=replace(cameras, viewmats=viewmats))
    (reported,) = warnings(replace(photos, scene=turned))
    assert reported.startswith("1 of ") and cameras.names[index] in reported


def test_a_stray_camera_is_named(photos: Any) -> None:
    """Oracle: one camera 1e6 away from the others."""
    cameras = photos.scene.cameras
    viewmats = cameras.viewmats.copy()
    viewmats[1, :3, 3] += 1e6
    stray = replace(photos.scene, cameras=replace(cameras, viewmats=viewmats))
    reported = warnings(replace(photos, scene=stray))
    assert (
        reported[0].startswith(f"{cameras.names[1]}: ")
        and "farther from the other cameras" in reported[0]
    )


def test_an_impossible_principal_point_is_named(photos: Any) -> None:
    """Oracle: one camera's moved by twenty widths."""
    cameras = photos.scene.cameras
    Ks = cameras.Ks.copy()
    Ks[2, 0, 2] += 20 * cameras.widths[2]
    moved = replace(photos.scene, cameras=replace(cameras, Ks=Ks))
    reported = warnings(replace(photos, scene=moved))
    assert reported[0].startswith(f"{cameras.names[2]}: the principal point is 20 times")


def test_stray_points_are_counted(photos: Any) -> None:
    """Oracle: five points 1e5 times as far away."""
    points = photos.scene.points.points.copy()
    points[:5] *= 1e5
    reported = [w for w in warnings(with_points(photos, points)) if "points are" in w]
    assert len(reported) == 1 and reported[0].startswith(f"5 of {len(points)} points")
