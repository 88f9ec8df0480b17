"""Predicted against used memory, in separate processes; oracle: VmHWM, counted by the kernel."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscore.bench.synthetic import SyntheticPhotos
from gscore.io.colmap.folder import read_model, write_model
from gscore.io.colmap.model import ColmapPoints

POINTS = 1_500_000
_RUN = """
import json, sys
from pathlib import Path
from gscore.config import DataConfig, TrainConfig
from gscore.events import Estimated
from gscore.trainer.run import train
said = []
def tell(event):
    if isinstance(event, Estimated):
        said.append(event.peak_bytes)
source, width = Path(sys.argv[1]), float(sys.argv[2])
config = TrainConfig(iterations=3, max_splats=500, sh_degree=0, lpips=None, coarse_factor=1.0)
data = DataConfig(source=source, resolution=width)
train(config, data, source / "out", tell, overwrite=True)
status = Path("/proc/self/status").read_text()
print(json.dumps([said[0], 1024 * int(status.split("VmHWM:")[1].split()[0])]))
"""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc"),
]


def said_and_taken(source: Path, width: float) -> tuple[float, float]:
    """Predicted and peak bytes of a training."""
    command = [sys.executable, "-c", _RUN, str(source), str(width)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    said, taken = json.loads(done.stdout.splitlines()[-1])
    return said, taken


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A capture of four small photos."""
    SyntheticPhotos(500, 64, 48).write(tmp_path, 4)
    return tmp_path


def test_many_points(source: Path) -> None:
    """Oracle: the peak of a run from 1.5 million points to 500 splats."""
    few, few_taken = said_and_taken(source, 1)
    rng = np.random.default_rng(0)
    points = ColmapPoints(
        ids=np.arange(POINTS, dtype=np.int64) + 1,
        xyz=rng.normal(size=(POINTS, 3)),
        rgb=rng.integers(1, 255, (POINTS, 3)).astype(np.uint8),
        error=np.ones(POINTS),
        track_lengths=np.zeros(POINTS, np.int32),
    )
    model = read_model(source)
    write_model(replace(model, points=points), model.path)
    said, taken = said_and_taken(source, 1)
    assert 27 < (taken - few_taken) / POINTS < 90
    assert said - few > 50 * POINTS
    assert taken == pytest.approx(said, rel=0.3)


def test_large_photos(source: Path) -> None:
    """Oracle: the peak of a run from four photos of 48 megapixels to 400 px."""
    files = [path for path in source.rglob("*") if path.suffix.lower() in (".png", ".jpg")]
    assert len(files) == 4
    for path in files:
        with Image.open(path) as photo:
            photo.convert("RGB").resize((8000, 6000)).save(path)
    said, taken = said_and_taken(source, 400)
    assert said > 0.5e9
    assert taken == pytest.approx(said, rel=0.3)
