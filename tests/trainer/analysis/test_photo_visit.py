"""What decides on a training is read once: tracks, photos and masks."""

import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gscore.choices import Background
from gscore.config import DataConfig, Switch, TrainConfig
from gscore.datasets import Dataset, load_dataset
from gscore.datasets import tracks as tracks_module
from gscore.io.images.png import write_png
from gscore.trainer.analysis.photo_visit import backdrop_share, visit_photos
from gscore.trainer.run import train


@pytest.fixture
def masked(capture: Path, tmp_path: Path) -> DataConfig:
    """The toy capture with masks of different brightness."""
    shutil.copytree(capture, tmp_path / "in")
    for k, photo in enumerate(sorted((capture / "images").iterdir())):
        write_png(tmp_path / "in/masks" / photo.name, np.full((48, 48), 255 - k, np.uint8))
    return DataConfig(source=tmp_path / "in", mask_mode="ignore")


def test_photos_that_are_not_kept_are_decoded_once(
    masked: DataConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: one decoding per view for masks and colours together; the masks as written."""
    photos, decoded = load_dataset(masked), Counter[int]()
    photos.limit_cache()
    whole = Dataset._decoded

    def counted(self: Dataset, index: int) -> Any:
        decoded[index] += 1
        return whole(self, index)

    monkeypatch.setattr(Dataset, "_decoded", counted)
    facts = visit_photos(TrainConfig(exposure=Switch.ON, threads=1), photos)
    assert decoded == Counter(dict.fromkeys(photos.train, 1))
    assert facts.brightest == [255 - i for i in photos.train]
    assert facts.colors is not None and facts.colors.views == len(photos.train)
    assert list(facts.cells) == photos.train
    assert not facts.cells[photos.train[1]].counted.any()  # masks are below 255


def test_backdrops_are_counted_inside_the_masks() -> None:
    """Oracle: shares by construction, with noise of up to three levels."""
    image = np.full((10, 10, 3), 120, np.uint8)
    image[:4] = np.random.default_rng(0).integers(0, 4, (4, 10, 3))
    image[9] = 253
    image[8] = (0, 0, 9)
    mask = np.zeros((10, 10), np.uint8)
    mask[2:6] = 255
    assert backdrop_share(image, None, 0) == pytest.approx(0.4)
    assert backdrop_share(image, None, 255) == pytest.approx(0.1)
    assert backdrop_share(image, mask, 0) == pytest.approx(0.5)
    assert backdrop_share(image, mask * 0, 0) == 0


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, True),
        ({"background": Background.WHITE}, False),
        ({"background": Background.RANDOM}, False),
        ({"opaque_weight": 0.0}, False),
        ({"exposure": Switch.OFF}, True),
    ],
)
def test_the_backdrop_is_that_of_the_background(
    capture: Path, changes: dict[str, Any], expected: bool
) -> None:
    """Oracle: the toy capture, whose photos are black around the splats."""
    photos = load_dataset(DataConfig(source=capture))
    config = replace(TrainConfig(opaque_weight=0.005, threads=1), **changes)
    assert (visit_photos(config, photos).backdrop > 0.1) == expected


def test_a_training_reads_its_tracks_once(
    masked: DataConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: one reading of the COLMAP model with tracks, although exposure, poses and a guide
    mesh all need them."""
    read: list[int] = []
    whole = tracks_module.model_of
    monkeypatch.setattr(
        tracks_module, "model_of", lambda *args, **how: read.append(1) or whole(*args, **how)
    )
    mesh = tmp_path / "wall.obj"
    mesh.write_text("v -9 -9 0\nv 9 -9 0\nv 0 9 0\nf 1 2 3\n")
    train(TrainConfig(iterations=1, max_splats=200, guide_free=mesh), masked, tmp_path / "out")
    assert read == [1]


def test_nothing_is_read_that_no_option_needs(
    capture: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: a capture whose photos cannot be decoded, without masks."""
    photos = load_dataset(DataConfig(source=capture))
    monkeypatch.setattr(Dataset, "_decoded", lambda *_: pytest.fail("decoded"))
    config = TrainConfig(exposure=Switch.OFF, refine_poses=Switch.OFF, sky=Switch.OFF)
    facts = visit_photos(config, photos)
    assert (facts.tracks, facts.brightest, facts.colors, facts.stops) == (None, [], None, None)
