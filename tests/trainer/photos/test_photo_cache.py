"""Photos that exceed the memory; oracle: the bits of a training that keeps them all."""

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gscore.config import DataConfig, TrainConfig
from gscore.control import Control
from gscore.datasets import load_dataset
from gscore.events import Estimated, Event
from gscore.io.images.png import write_png
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.analysis.photo_loading import check_masks, load_photos
from gscore.trainer.analysis.photo_visit import visit_photos
from gscore.trainer.photos.image_pyramid import ImagePyramid
from gscore.trainer.run import train
from gscore.trainer.trainer import Trainer

pytestmark = pytest.mark.usefixtures("fake_engine")

CONFIG = TrainConfig(iterations=40, max_splats=200, refine_start=10, refine_every=10)


def test_a_small_cache_gives_the_same_bits(photos: Any) -> None:
    """Oracle: all tensors after 40 steps through several sizes, with a cache of two photos."""
    trainers = [
        Trainer(CONFIG, Analysis(photos=photos)),
        Trainer(CONFIG, Analysis(photos=photos, photo_cache=2 * 48 * 48 * 3)),
    ]
    for _ in range(40):
        for trainer in trainers:
            trainer.step()
    ours, theirs = (trainer.tensors() for trainer in trainers)
    assert ours.keys() == theirs.keys()
    assert all(np.array_equal(ours[name].numpy(), theirs[name].numpy()) for name in ours)


def test_masks_and_depth_maps_are_counted(capture: Path, tmp_path: Path) -> None:
    """Oracle: by hand: for eight photos of 48 x 48 px, masks of a byte a pixel and depth maps of 11
    bytes a pixel."""
    bare, masked = capture, tmp_path / "in"
    shutil.copytree(capture, masked)
    for photo in (capture / "images").iterdir():
        write_png(masked / "masks" / photo.name, np.full((48, 48), 255, np.uint8))

    def reported(root: Path, depths: bool) -> Estimated:
        events, config = list[Event](), replace(CONFIG, coarse_factor=1)
        load_photos(
            load_dataset(DataConfig(source=root)),
            config,
            points=100,
            depths=depths,
            announce=True,
            emit=events.append,
            control=Control(),
        )
        return next(e for e in events if isinstance(e, Estimated))

    pixels = 8 * 48 * 48
    plain, masks, maps = reported(bare, False), reported(masked, False), reported(bare, True)
    assert (plain.photo_bytes, masks.photo_bytes) == (3 * pixels, 4 * pixels)
    assert masks.peak_bytes - plain.peak_bytes == pixels
    assert maps.peak_bytes - plain.peak_bytes == 11 * pixels


def test_label_masks_warn(capture: Path, tmp_path: Path) -> None:
    """Oracle: almost zero weight for 0, 1 and 2 of 255; no message for masks that reach white."""
    shutil.copytree(capture, tmp_path / "in")
    for k, photo in enumerate(sorted((capture / "images").iterdir())):
        labels = np.tile(np.uint8([0, 1, 2]), (48, 16))
        write_png(tmp_path / "in/masks" / photo.name, labels * np.uint8(1 if k < 2 else 127))
    photos = load_dataset(DataConfig(source=tmp_path / "in"))
    (warning,) = check_masks(photos, visit_photos(CONFIG, photos))
    assert warning.startswith("The masks of 2 training views are nearly black, for example view_00")


@pytest.fixture
def counted(photos: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """Views that were decoded, in order."""
    seen: list[int] = []
    whole = type(photos).image

    def image(self: Any, index: int) -> np.ndarray:
        seen.append(index)
        return whole(self, index)

    monkeypatch.setattr(type(photos), "image", image)
    yield seen


def test_the_cache_is_bounded_and_the_next_views_come_in_time(
    photos: Any, counted: list[int]
) -> None:
    """Oracle: cached bytes, and the order of decoded views."""
    size = 48 * 48 * 3
    pyramid = ImagePyramid(photos, photos.scene.cameras, near=0.01, limit=3 * size)
    order = [5, 1, 7, 0, 3, 2]
    for place, index in enumerate(order):
        pyramid.at(index, 1.0, upcoming=order[place + 1 :])
        assert sum(s.image.nbytes for s in pyramid._kept.values()) <= 3 * size
    assert sorted(counted) == sorted(order), "each once: none is made twice"
    assert sorted(pyramid._kept) == [1, 5, 7]
    pyramid.at(5, 1.0)
    assert len(counted) == 6
    pyramid.at(5, 2.0)
    assert len(counted) == 7


def test_views_are_scaled_before_their_steps(photos: Any) -> None:
    """Oracle: the views that were named, of which those that are kept are not made again; the
    pixels of a pyramid that makes one at a time."""
    pyramid, alone = (ImagePyramid(photos, photos.scene.cameras, near=0.01) for _ in range(2))
    order = [5, 1, 7, 0, 3, 2]
    for place, index in enumerate(order):
        found = pyramid.at(index, 1.5, upcoming=order[place + 1 :])
        assert sorted(pyramid._coming) == sorted(order[place + 1 :])
        assert np.array_equal(found.image, alone.at(index, 1.5).image)
    pyramid.at(5, 1.5, upcoming=(i for i in [6]))
    assert not pyramid._coming, "a photo that is there asks for no others"


def test_few_decoded_views_are_held(capture: Path) -> None:
    """Oracle: the bytes of a dataset that keeps all views."""
    data = DataConfig(source=capture)
    whole, few = load_dataset(data), load_dataset(data)
    few.limit_cache()
    for i in range(len(whole)):
        assert np.array_equal(whole.image(i), few.image(i))
    assert len(few._views) <= 4
    assert len(whole._views) == len(whole)


def test_small_cache_gives_equal_results(capture: Path, tmp_path: Path) -> None:
    """Oracle: splats and metrics of the run that keeps all photos; a megabyte is room for all."""
    data, events = DataConfig(source=capture, eval=True, test_every=4), list[Event]()
    whole = train(CONFIG, data, tmp_path / "whole", events.append)
    reported = [e for e in events if isinstance(e, Estimated)]
    assert [e.photos_kept for e in reported] == [True]
    assert reported[0].seconds > 0
    assert reported[0].peak_bytes > 200_000_000
    few = tmp_path / "few"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gscore.trainer.estimate.forecast.cache_bytes", lambda *_, **__: 20_000)
        part = train(replace(CONFIG, checkpoint_iterations=(15,)), data, few, events.append)
        step = few / "checkpoints" / "step_00000015.safetensors"
        again = train(CONFIG, data, tmp_path / "again", start_checkpoint=step)
    assert isinstance(next(e for e in reversed(events) if isinstance(e, Estimated)), Estimated)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gscore.trainer.estimate.forecast.decodes_again", lambda *_, **__: True)
        anew = train(CONFIG, data, tmp_path / "anew", events.append)
    assert next(e for e in reversed(events) if isinstance(e, Estimated)).photos_kept
    for other in (part, again, anew):
        assert np.array_equal(whole.splats.means, other.splats.means)
        assert np.array_equal(whole.splats.sh0, other.splats.sh0)
        assert whole.metrics["psnr"] == other.metrics["psnr"]
