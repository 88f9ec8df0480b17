"""What decides on a training is read once: tracks, photos and masks."""

import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gscore.config import DataConfig, Switch, TrainConfig
from gscore.datasets import Dataset, load_dataset
from gscore.datasets import tracks as tracks_module
from gscore.io.images.png import write_png
from gscore.trainer.analysis.photo_visit import visit_photos
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
    facts = visit_photos(TrainConfig(exposure=Switch.OFF, refine_poses=Switch.OFF), photos)
    assert (facts.tracks, facts.brightest, facts.colors, facts.stops) == (None, [], None, None)
