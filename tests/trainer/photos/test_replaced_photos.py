"""Photos that change while a training reads them repeatedly."""

import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gscore.config import DataConfig, TrainConfig
from gscore.control import Control
from gscore.datasets import Dataset, load_dataset
from gscore.errors import ConfigError, DatasetError, GsError
from gscore.events import Event, Progress
from gscore.io.images.png import write_png
from gscore.io.images.read_image import read_image
from gscore.trainer import prepare as prepare_module
from gscore.trainer.files.run_folder import RunFolder
from gscore.trainer.run import train

pytestmark = pytest.mark.usefixtures("fake_engine")

CONFIG = TrainConfig(iterations=60, max_splats=200, refine_start=10, refine_every=10)


@pytest.fixture
def root(capture: Path, tmp_path: Path) -> Path:
    """A writable copy of the toy capture."""
    shutil.copytree(capture, tmp_path / "in")
    photo = photo_of(tmp_path / "in")
    photo.write_bytes(photo.read_bytes() + bytes(5000))  # readers stop at the end of a PNG
    shutil.copy(photo, tmp_path / "first.png")
    return tmp_path / "in"


def photo_of(root: Path) -> Path:
    return root / "images" / "view_03.png"


def invert(path: Path) -> None:
    write_png(path, 255 - read_image(path))


def invert_in_disguise(path: Path) -> None:
    """Write another picture of the same size and time."""
    before, image = path.stat(), read_image(path)
    write_png(path, image[::-1])
    path.write_bytes(path.read_bytes().ljust(before.st_size, b"\0"))
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert path.stat().st_size == before.st_size


def remove(path: Path) -> None:
    path.unlink()


def touch(path: Path) -> None:
    os.utime(path, ns=(1, 1))


def few(root: Path) -> Dataset:
    data = load_dataset(DataConfig(source=root))
    data.limit_cache()
    return data


@pytest.mark.parametrize("change", [invert, invert_in_disguise, remove])
def test_a_photo_that_changed_is_refused_when_it_is_read_again(
    root: Path, change: Callable[[Path], None]
) -> None:
    """Oracle: the file's name; the other photos unchanged."""
    data = few(root)
    for i in range(len(data)):
        data.image(i)
    change(photo_of(root))
    for i in range(len(data)):
        if i == 3:
            with pytest.raises(DatasetError, match=photo_of(root).name):
                data.image(i)
        else:
            assert data.image(i).size


def test_a_photo_that_changed_before_it_was_read_is_refused(root: Path) -> None:
    """Oracle: the header read when the capture was opened; photos kept or not."""
    for data in (load_dataset(DataConfig(source=root)), few(root)):
        invert(photo_of(root))
        with pytest.raises(DatasetError, match=r"changed after the capture was read"):
            data.image(3)
        with pytest.raises(DatasetError, match=r"changed after the capture was read"):
            data.content_hash()


def test_photos_that_are_kept_may_change(root: Path) -> None:
    """Oracle: the previous picture."""
    data = load_dataset(DataConfig(source=root))
    before = data.image(3).copy()
    invert(photo_of(root))
    np.testing.assert_array_equal(data.image(3), before)


def test_masks_are_watched_too(root: Path) -> None:
    """Oracle: the name of the mask."""
    for path in (root / "images").iterdir():
        write_png(root / "masks" / path.name, np.tile(np.uint8([0, 255]), (48, 24)))
    data = few(root)
    for i in range(len(data)):
        data.mask(i)
    invert(root / "masks" / photo_of(root).name)
    with pytest.raises(DatasetError, match=r"masks/.* changed after the capture was read"):
        data.mask(3)


def test_a_photo_that_is_copied_back_is_the_same(root: Path, tmp_path: Path) -> None:
    """Oracle: the same bytes with another time, which are the same photo."""
    data = few(root)
    data.content_hash()
    data.image(3)
    data.limit_cache()
    touch(photo_of(root))
    first = data.image(3).copy()
    data.limit_cache()
    invert(photo_of(root))
    shutil.copy(tmp_path / "first.png", photo_of(root))
    np.testing.assert_array_equal(data.image(3), first)


@pytest.fixture
def little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Room for two photos, so that the others are read repeatedly."""
    monkeypatch.setattr("gscore.trainer.estimate.forecast.cache_bytes", lambda *_, **__: 20_000)


@pytest.mark.usefixtures("little_memory")
@pytest.mark.parametrize("change", [invert, invert_in_disguise, remove])
@pytest.mark.parametrize("watchdog", [True, False])
def test_a_run_stops_and_goes_on(
    root: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    change: Callable[[Path], None],
    watchdog: bool,
) -> None:
    """Oracle: the bits of an undisturbed run; the steps before the change are kept."""
    config = replace(CONFIG, watchdog=watchdog, checkpoint_seconds=0.0)
    data = DataConfig(source=root)
    whole = train(config, data, tmp_path / "whole")

    class Changing(prepare_module.Trainer):
        def advance(self) -> object:
            if self.steps == 20:
                change(photo_of(root))
            return super().advance()

    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(prepare_module, "Trainer", Changing)
        with pytest.raises(GsError) as caught:
            train(config, data, out)
    message = str(caught.value)
    assert str(photo_of(root)) in message
    steps = int(message.partition("Step ")[2].split()[0])
    assert 20 <= steps < 60
    assert f"is kept in {out}" in message and "--resume" in message
    assert RunFolder(out).checkpoint(steps).is_file()
    other = "names" if change is remove else "photos"
    with pytest.raises(ConfigError, match=f"{other} of the capture are not the same"):
        train(config, data, out, resume=True)
    shutil.copy(tmp_path / "first.png", photo_of(root))
    events: list[Event] = []
    again = train(config, data, out, events.append, Control(), resume=True)
    assert all(e.step >= steps for e in events if isinstance(e, Progress) and e.phase == "growing")
    for name in ("means", "scales", "quats", "opacities", "sh0", "shN"):
        assert np.array_equal(getattr(whole.splats, name), getattr(again.splats, name)), name
