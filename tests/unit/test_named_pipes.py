"""Refusal of files that are not regular, without waiting; an alarm ends a test that opens one."""

import os
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from gscore.config import DataConfig
from gscore.config_file import load_config
from gscore.datasets import load_dataset
from gscore.datasets.dataset import _hash
from gscore.depth.maps import MapFolder, check_exr_size, read_map
from gscore.errors import Cancelled, ConfigError, DatasetError
from gscore.io.cameras_json import read_cameras_json
from gscore.io.colmap.binary import count_images
from gscore.io.files import read_bytes
from gscore.io.images.read_image import read_image, read_info, read_mask
from gscore.io.metrics_file import read_metrics
from gscore.io.ply.splats import is_antialiased_ply, read_ply
from gscore.trainer.files import checkpoint

pytestmark = pytest.mark.skipif(os.name == "nt", reason="named pipes in folders are POSIX's")


@pytest.fixture(autouse=True)
def alarm() -> Iterator[None]:
    """TimeoutError where a test waits for 3 s."""

    def late(number: int, frame: FrameType | None) -> None:
        raise TimeoutError("opened a named pipe")

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, 3)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize(
    ("read", "name"),
    [
        (read_bytes, "a.bin"),
        (count_images, "images.bin"),
        (check_exr_size, "a.exr"),
        (read_info, "a.png"),
        (read_info, "a.tif"),
        (read_image, "a.jpg"),
        (read_mask, "a.png"),
        (read_map, "a.png"),
        (read_map, "a.npy"),
        (read_map, "a.exr"),
        (read_ply, "a.ply"),
        (is_antialiased_ply, "a.ply"),
        (read_cameras_json, "cameras.json"),
        (checkpoint.load, "step_00000001.safetensors"),
        (_hash, "a.png"),
    ],
)
def test_every_reader_refuses_a_named_pipe(
    read: Callable[[Path], Any], name: str, tmp_path: Path
) -> None:
    """Oracle: the sentence, with the file and its kind; no wait for a writer."""
    os.mkfifo(tmp_path / name)
    with pytest.raises(DatasetError, match=rf"{name} is a named pipe, a file was expected\. Put"):
        read(tmp_path / name)


def test_a_config_that_is_a_pipe_is_refused(tmp_path: Path) -> None:
    """Oracle: no wait for a writer."""
    os.mkfifo(tmp_path / "config.json")
    with pytest.raises(ConfigError, match=r"config\.json: expected a config file"):
        load_config(tmp_path / "config.json")


def test_metrics_that_are_a_pipe_count_as_missing(tmp_path: Path) -> None:
    """Oracle: no wait for a writer."""
    os.mkfifo(tmp_path / "metrics.json")
    assert read_metrics(tmp_path) == {}


def test_other_kinds_are_named() -> None:
    """Oracle: a device that never ends."""
    with pytest.raises(DatasetError, match="/dev/zero is a device"):
        read_bytes(Path("/dev/zero"))


@pytest.mark.parametrize("place", ["images", "masks"])
def test_a_capture_with_a_pipe_is_refused(make_capture: Callable, place: str) -> None:
    """Oracle: the name of the photo or mask that it replaces."""
    made = make_capture()
    shutil.copytree(made.root / "images", made.root / "masks", dirs_exist_ok=True)
    victim = made.root / place / "view_00.png"
    victim.unlink()
    os.mkfifo(victim)
    with pytest.raises(DatasetError, match=f"{victim.name} is a named pipe"):
        load_dataset(DataConfig(source=made.root))


def test_a_depth_map_that_is_a_pipe_is_refused(tmp_path: Path) -> None:
    """Oracle: the list of the folder, in which it is a file."""
    os.mkfifo(tmp_path / "view.npy")
    found = MapFolder(tmp_path).find("view.png")
    assert found is not None
    with pytest.raises(DatasetError, match=r"view\.npy is a named pipe"):
        read_map(found)


def test_reading_headers_can_be_stopped(make_capture: Callable) -> None:
    """Oracle: one check per photo, the second of which stops it."""
    asked: list[int] = []

    def cancelled() -> bool:
        asked.append(1)
        return len(asked) == 2

    with pytest.raises(Cancelled, match="Reading the photos was stopped"):
        load_dataset(DataConfig(source=make_capture().root), cancelled=cancelled)
    assert len(asked) == 2
