"""The decision on exposure, by the studio example and copies of it; and the files of a run."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gscore.config import DataConfig, Switch, TrainConfig
from gscore.datasets import Dataset, load_dataset
from gscore.events import Started
from gscore.io.exposure_json import write_exposures
from gscore.io.images.read_image import read_image
from gscore.photo_exposure import PhotoExposure
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.analysis.exposure import (
    Exposure,
    decide_exposure,
    stops_off_neighbours,
)
from gscore.trainer.analysis.photo_visit import PhotoFacts, stated_exposure, visit_photos
from gscore.trainer.run import train
from gscore.trainer.views.photo_gains import PhotoGains
from tests.light_changes import exposed_bytes

STUDIO = Path(__file__).parents[3] / "examples" / "studio"
STOP = np.log(2) / 2.4
"""ln gain of encoded values that is reported as one stop."""


class Exposed(Dataset):
    """A capture with photos exposed by gains."""

    def __init__(self, plain: Dataset, log_gains: np.ndarray) -> None:
        super().__init__(
            scene=plain.scene,
            files=list(plain.files),
            train=plain.train,
            test=plain.test,
            mask_mode=plain.mask_mode,
            source=plain.source,
        )
        self._plain, self._gains = plain, np.exp(log_gains)

    def image(self, index: int) -> np.ndarray:
        return exposed_bytes(self._plain.image(index), self._gains[index])


@pytest.fixture(scope="module")
def studio() -> Dataset:
    """The example at 240 px, all of it without masks."""
    return load_dataset(DataConfig(source=STUDIO, resolution=240, eval=True, mask_mode="none"))


def _decided(config: TrainConfig, photos: Dataset) -> Exposure:
    return decide_exposure(config, Analysis(photos=photos, facts=visit_photos(config, photos)))


def test_studio_photos_have_one_exposure(studio: Dataset) -> None:
    """Oracle: the example was rendered with one exposure; gains begin near one."""
    found = _decided(TrainConfig(), studio)
    assert found.gains is not None and found.numbers is not None and found.decision is not None
    assert "(0.0" in found.decision.text and found.numbers["stops_apart"] < 0.13
    assert np.abs(found.gains.log_gains).max() < 0.15 * STOP


def test_gains_of_a_capture_begin_near_the_truth(studio: Dataset) -> None:
    """Oracle: the gains applied to the photos, about their mean, a third of a stop apart."""
    truth = np.random.default_rng(0).normal(0, 0.12, (len(studio), 3))
    found = _decided(TrainConfig(), Exposed(studio, truth))
    assert found.gains is not None
    assert "(0.3" in found.decision.text and "points seen" in found.decision.text
    train_views = studio.train
    error = found.gains.log_gains[train_views] - truth[train_views]
    error -= error.mean(axis=0)
    assert np.sqrt((error**2).mean()) < 0.02
    assert not found.gains.log_gains[studio.test].any()


def test_a_single_bright_photo_is_found(studio: Dataset) -> None:
    """Oracle: one photo of 52 brighter by one stop and a half; its gain, others near one."""
    truth = np.zeros((len(studio), 3))
    truth[studio.train[5]] = 1.5 * STOP
    found = _decided(TrainConfig(), Exposed(studio, truth))
    assert found.gains is not None
    gains = found.gains.log_gains / STOP
    assert gains[studio.train[5]] == pytest.approx(np.full(3, 1.5), abs=0.15)
    others = np.delete(gains[studio.train], 5, axis=0)
    assert np.abs(others).max() < 0.15


@pytest.mark.parametrize("mode", list(Switch))
@pytest.mark.parametrize("count", [1, 2])
def test_the_rule(studio: Dataset, mode: Switch, count: int) -> None:
    """Oracle: the rule in words: off as set and, unless set on, for a single photo, with a reason;
    without points and EXIF gains begin at one."""
    few: Any = SimpleNamespace(scene=studio.scene, train=studio.train[:count])
    found = decide_exposure(TrainConfig(exposure=mode), Analysis(photos=few, facts=PhotoFacts()))
    learns = mode is Switch.ON or (mode is Switch.AUTO and count > 1)
    assert (found.gains is not None) is learns
    assert (found.decision is None) is (mode is Switch.OFF)
    if found.gains is not None:
        assert not found.gains.log_gains.any()


@pytest.mark.parametrize("mode", [Switch.AUTO, Switch.ON])
def test_a_part_of_a_capture_keeps_the_exposure_of_its_surroundings(
    studio: Dataset, mode: Switch
) -> None:
    """Oracle: gains of a region or a block only if requested, because their mean is 1 over its
    photos."""
    part: Any = SimpleNamespace(scene=studio.scene, train=studio.train)
    analysis = Analysis(photos=part, facts=PhotoFacts(), is_part=True)
    found = decide_exposure(TrainConfig(exposure=mode), analysis)
    assert (found.gains is not None) is (mode is Switch.ON)
    assert found.decision is not None
    assert found.decision.text.startswith("Colours are used unchanged") is (mode is Switch.AUTO)


def test_photos_are_compared_with_their_neighbours() -> None:
    """Oracle: the standard deviation of random exposures at any places; along a path the
    differences from four neighbours one by one; cameras in one place; one photo."""
    rng = np.random.default_rng(1)
    places = rng.normal(size=(4000, 3))
    random = np.repeat(rng.normal(0, 0.4 * STOP, (4000, 1)), 3, axis=1)
    assert together(random, places) == pytest.approx(0.4, rel=0.03)
    assert together(random, np.zeros((4000, 3))) == pytest.approx(0.4, rel=0.03)
    way = np.arange(100.0)[:, None] * [1.0, 0, 0]
    slowly = np.repeat(np.sin(way[:, :1] / 30), 3, axis=1)
    slow = [
        slowly[i, 0]
        - np.mean([slowly[j, 0] for j in sorted(range(100), key=lambda j: (abs(j - i), j))[1:5]])
        for i in range(100)
    ]
    expected = np.sqrt(np.mean(np.square(slow)) / 1.25) / STOP
    assert together(slowly, way) == pytest.approx(expected, rel=0.05)
    assert together(slowly, way) < 0.05 * slowly.std() / STOP
    assert stops_off_neighbours(random[:1], places[:1]).tolist() == [0.0]


def together(log_gains: np.ndarray, centers: np.ndarray) -> float:
    return float(np.sqrt((stops_off_neighbours(log_gains, centers) ** 2).mean()))


def test_off_looks_at_nothing(studio: Dataset) -> None:
    """Oracle: no sentence, no numbers, no gains."""
    found = _decided(TrainConfig(exposure=Switch.OFF), studio)
    assert (found.gains, found.decision, found.numbers) == (None, None, None)


def _photo(path: Path, tags: dict[int, Any]) -> Path:
    exif = Image.Exif()
    exif.get_ifd(0x8769).update(tags)
    Image.new("RGB", (8, 8), (90, 90, 90)).save(path, exif=exif)
    return path


def test_exif_says_how_photos_were_exposed(tmp_path: Path) -> None:
    """Oracle: twice the time, ISO speed, or aperture's area as a stop; no result for invalid or
    missing numbers."""
    time, aperture, speed = 0x829A, 0x829D, 0x8827
    tags = {time: 0.01, aperture: 2.0, speed: 100}
    base = stated_exposure(_photo(tmp_path / "a.jpg", tags))
    assert base == pytest.approx(np.log2(0.01 * 100 / 4), abs=1e-3)
    assert stated_exposure(_photo(tmp_path / "b.jpg", tags | {time: 0.04})) == pytest.approx(
        base + 2, abs=1e-3
    )
    assert stated_exposure(_photo(tmp_path / "c.jpg", tags | {aperture: 4.0})) == pytest.approx(
        base - 2, abs=1e-3
    )
    assert stated_exposure(_photo(tmp_path / "d.jpg", {time: 0.01, speed: 100})) is None
    assert stated_exposure(_photo(tmp_path / "e.jpg", tags | {speed: 0})) is None
    plain = tmp_path / "f.png"
    Image.new("RGB", (8, 8)).save(plain)
    assert stated_exposure(plain) is None


def test_a_run_writes_its_exposures(capture: Path, tmp_path: Path) -> None:
    """Oracle: the gains of the trainer's checkpoint in the layout of 3DGS, [3][4] by name, those of
    held-out photos near their neighbours'; the sentence in the event and in metrics.json."""
    config = TrainConfig(
        iterations=40, max_splats=200, exposure=Switch.ON, exposure_lr=0.05, exposure_lr_final=0.05
    )
    data = DataConfig(source=capture, eval=True, test_every=4)
    messages: list[Any] = []
    result = train(config, data, tmp_path / "out", messages.append)
    stated = json.loads((tmp_path / "out/exposure.json").read_text())
    names = sorted(p.name for p in (capture / "images").iterdir())
    assert sorted(stated) == names
    maps = np.array([stated[name] for i, name in enumerate(names) if i % 4])
    held_out = np.array([stated[name] for name in names[::4]])
    assert maps.shape == (6, 3, 4) and np.abs(held_out).max() <= np.abs(maps).max()
    diagonal = maps[:, range(3), range(3)]
    assert not maps[..., :3][:, ~np.eye(3, dtype=bool)].any(), "more than gains"
    np.testing.assert_allclose(maps[..., 3], 0.055 * (diagonal - 1), rtol=1e-6)
    np.testing.assert_allclose(np.log(diagonal).mean(axis=0), 0, atol=1e-12)
    assert np.abs(np.log(diagonal)).max() > 0.005, "nothing was learnt"
    (started,) = (event for event in messages if isinstance(event, Started))
    assert started.decision("exposure").startswith("The exposure of each photo is optimised; held")
    assert result.metrics["exposure"]["learnt"] is True


def test_exposed_photos_are_measured_as_photos(capture: Path, tmp_path: Path) -> None:
    """Oracle: the PSNR of the training photos with their gains, near that of one exposure; neutral
    pictures would lose it."""
    dark = tmp_path / "dark"
    for path in capture.rglob("*"):
        if path.is_file() and path.parent.name != "images":
            copy = dark / path.relative_to(capture)
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(path.read_bytes())
    (dark / "images").mkdir()
    for i, path in enumerate(sorted((capture / "images").iterdir())):
        image = exposed_bytes(read_image(path)[..., :3], 1.0 if i % 2 else 0.7)
        Image.fromarray(image).save(dark / "images" / path.name)
    config = TrainConfig(
        iterations=300, max_splats=300, exposure=Switch.ON, exposure_lr=0.05, sh_degree=0
    )
    photo_parameters = train(config, DataConfig(source=dark), tmp_path / "on").psnr
    plain = train(
        replace(config, exposure=Switch.OFF), DataConfig(source=dark), tmp_path / "off"
    ).psnr
    assert photo_parameters is not None and plain is not None
    assert photo_parameters > plain + 2


def test_a_part_keeps_the_exposures_of_its_surroundings(photos: Any, tmp_path: Path) -> None:
    """Oracle: the gains in the file beside the start splats, those of light nearest to gains of
    values, after a step of learning and a restart too; none if the file lacks a training photo, and
    for a whole capture."""
    cameras, rng = photos.scene.cameras, np.random.default_rng(0)
    config = TrainConfig(start_splats=tmp_path / "point_cloud.ply")
    analysis = Analysis(photos=photos, facts=PhotoFacts(), is_part=True)
    assert decide_exposure(config, analysis).gains is None
    given = {name: PhotoExposure.of(rng.uniform(0.8, 1.2, 3)) for name in cameras.names}
    given[cameras.names[photos.train[0]]] = PhotoExposure(np.array([0.8, 1.0, 1.4]), np.zeros(3))
    write_exposures(tmp_path / "exposure.json", given)
    gains = decide_exposure(config, analysis).gains
    assert gains is not None
    expected = np.log([given[cameras.names[i]].gain for i in photos.train])
    expected[0] = np.log(given[cameras.names[photos.train[0]]].nearest_gain)
    assert np.abs(expected[0] - np.log([0.8, 1.0, 1.4])).max() > 0.01
    for _ in range(2):
        np.testing.assert_allclose(gains.log_gains[photos.train], expected, atol=1e-12)
        gains.learn(photos.train[0], (1.0, -2.0, 3.0), 0.1)
        gains = PhotoGains.restored(photos.train, len(cameras), gains.arrays(), fixed=True)
    del given[cameras.names[photos.train[1]]]
    write_exposures(tmp_path / "exposure.json", given)
    assert decide_exposure(config, analysis).gains is None
    whole = decide_exposure(config, replace(analysis, is_part=False)).gains
    assert whole is not None and not whole.fixed
