"""Fixtures of tests for graphics cards: a private cache folder, a fake library, a real device."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from gscore.raster.gpu import absence, choice, gpu_raster, library, verdict
from gscore.raster.gpu.devices import Device, find_devices
from tests.gpu.drivers import absent
from tests.gpu.fake_gpu import FakeGpu
from tests.run_verb import gscore  # noqa: F401
from tests.trainer.conftest import capture  # noqa: F401


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of the verdicts, empty; nothing of another test is remembered; `auto` looks for
    cards on any system."""
    folder = tmp_path / "cache"
    monkeypatch.setattr(verdict, "cache_folder", lambda: folder)
    monkeypatch.setattr(verdict, "_of_process", {})
    monkeypatch.setattr(choice, "_by_name", {})
    monkeypatch.setattr(absence, "_AUTO_ON", (sys.platform,))
    monkeypatch.setattr(absence, "may_have_card", lambda: True)
    monkeypatch.delenv("GSCORE_GPU_FAULT", raising=False)
    yield folder
    gpu_raster.close_all()


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Callable[..., FakeGpu]:
    """Replaces the library by a fake one with some cards."""

    def install(*cards: dict[str, Any], message: str = "") -> FakeGpu:
        made = FakeGpu(*cards, message=message)
        monkeypatch.setattr(library.LIBRARY, "loaded", made)
        return made

    return install


@pytest.fixture
def device() -> Device:
    """The first device of this machine."""
    found = find_devices()
    if not found.devices:
        absent(" ".join(found.problems))
    return found.devices[0]
