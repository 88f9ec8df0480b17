"""Rules on exposure, poses and masks without files; oracle: gains, poses and masks by design."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gscore.config import TrainConfig
from gscore.datasets.tracks import Tracks
from gscore.engine.base import TermKind
from gscore.errors import DatasetError
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.analysis.exposure import decide_exposure
from gscore.trainer.analysis.photo_loading import check_masks
from gscore.trainer.analysis.photo_visit import PhotoFacts, TrackColors
from gscore.trainer.analysis.pose_check import check_poses
from gscore.trainer.trainer import Trainer
from gscore.trainer.views.pose_math import moved_pose
from tests.trainer.short_run import CONFIG

POINTS = 40
STOP = np.log(2) / 2.4
"""ln gain of encoded values of one stop."""


def test_gains_come_from_shared_points(photos: Any) -> None:
    """Oracle: the gains that the colours were made with, about their mean."""
    count, rng = len(photos.train), np.random.default_rng(0)
    truth = rng.normal(0, STOP, (count, 3))
    view, point = np.repeat(np.arange(count), POINTS), np.tile(np.arange(POINTS), count)
    colors = rng.normal(-1, 0.3, (POINTS, 3))[point] + truth[view]
    facts = PhotoFacts(colors=TrackColors(view=view, point=point, log_color=colors, views=count))
    found = decide_exposure(TrainConfig(), Analysis(photos=photos, facts=facts))
    assert found.gains is not None and found.numbers is not None
    expected = truth - truth.mean(axis=0)
    np.testing.assert_allclose(found.gains.log_gains[photos.train], expected, atol=0.05)
    assert found.numbers["known_by"] == "points seen in several photos"


@pytest.mark.parametrize("step", [0.0, 1.0])
def test_gains_come_from_exif_without_points(photos: Any, step: float) -> None:
    """Oracle: exposures that alternate by `step` stops, none or one."""
    stops = step * (np.arange(len(photos.train)) % 2)
    facts = PhotoFacts(stops=stops)
    found = decide_exposure(TrainConfig(), Analysis(photos=photos, facts=facts))
    assert found.numbers is not None and found.numbers["known_by"] == "EXIF"
    assert found.gains is not None
    expected = STOP * (stops - stops.mean())
    np.testing.assert_allclose(found.gains.log_gains[photos.train, 0], expected, atol=1e-12)


def test_a_wrong_camera_is_realigned_to_its_points(photos: Any) -> None:
    """Oracle: the pose from which the points were observed; the other cameras stay."""
    cameras = photos.scene.cameras
    points = np.random.default_rng(0).normal(0, 0.3, (POINTS, 3)) + photos.scene.points.points[0]
    true = cameras.viewmats.copy()
    wrong = photos.train[2]
    true[wrong] = moved_pose(true[wrong], np.array([0.02, -0.01, 0.01, 0.05, 0.02, -0.03]))
    local = np.einsum("vij,pj->vpi", true[:, :3, :3], points) + true[:, None, :3, 3]
    assert (local[photos.train][..., 2] > 0).all()
    tracks = Tracks(
        points=points,
        observed=[np.arange(POINTS)] * len(true),
        rays=list(local[..., :2] / local[..., 2:]),
    )
    facts = PhotoFacts(tracks=tracks)
    found = check_poses(TrainConfig(), Analysis(photos=photos, facts=facts))
    assert found.viewmats is not None and not found.learns
    np.testing.assert_allclose(found.viewmats, true, atol=1e-6)
    assert found.decision is not None and "1 training camera misses its" in found.decision.text


def test_masks_are_refused_only_if_all_are_black() -> None:
    """Oracle: no masks, one of three black, all black."""
    file = SimpleNamespace(mask_inverted=False)
    photos: Any = SimpleNamespace(train=[0, 2, 3], names="abcd", source="in", files=[file] * 4)
    assert check_masks(photos, PhotoFacts()) == []
    (warning,) = check_masks(photos, PhotoFacts(brightest=[255, 0, 255]))
    assert warning == "The masks of 1 training view are black, for example c."
    with pytest.raises(DatasetError, match="no pixels to train on"):
        check_masks(photos, PhotoFacts(brightest=[0, 0, 0]))


@pytest.mark.parametrize(
    ("backdrop", "weight"), [(0.0, 0.02), (0.09, 0.02), (0.1, 0.0), (0.8, 0.0)]
)
def test_a_backdrop_stays_empty(photos: Any, backdrop: float, weight: float) -> None:
    """Oracle: the weight in the loss of the trainer, and the sentence."""
    analysis = Analysis(photos=photos, facts=PhotoFacts(backdrop=backdrop))
    trainer = Trainer(replace(CONFIG, opaque_weight=0.02), analysis)
    assert dict(trainer._terms.terms)[TermKind.SEE_THROUGH] == weight
    found = [one for one in trainer.rules.by_photos if one.topic == "opacity"]
    assert len(found) == (weight == 0)
    assert all("the background's colour" in one.text for one in found)
