"""A run saved by an earlier version; oracle: the results that this version wrote itself."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import gscore
from gscore import frontend
from tests.docs.small_studio import write_small_studio
from tests.forked import Forked

SAVED = Path(__file__).parents[1] / "saved_before" / "run"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """The run with its checkpoint at step 40 of 60, and its capture."""
    write_small_studio(tmp_path / "capture")
    shutil.copytree(SAVED, tmp_path / "run")
    return tmp_path / "run"


def test_its_results_are_read(run: Path) -> None:
    """Oracle: the numbers in its files."""
    found, metrics = frontend.read_run(run), json.loads((run / "metrics.json").read_text())
    assert found.psnr == pytest.approx(metrics["psnr"])
    assert len(gscore.read_splats(run / "point_cloud.ply").means) == 200


def test_its_checkpoint_continues_to_its_end(run: Path) -> None:
    """Oracle: the splats that the earlier version had after step 60, with the same kernels; its
    gains multiplied values and not light."""
    before = gscore.read_splats(run / "point_cloud.ply")
    (run / "metrics.json").unlink()
    done = Forked(
        ["-m", "gscore", "train", "capture", "-o", "run", "--resume"],
        cwd=run.parent,
        env={**os.environ, "GSCORE_ISA": "scalar"},
    )
    _, err = done.communicate(timeout=240)
    done.close()
    assert done.returncode == 0, err
    after = gscore.read_splats(run / "point_cloud.ply")
    for name in ("means", "quats", "scales", "opacities", "sh0", "shN"):
        np.testing.assert_allclose(
            getattr(after, name), getattr(before, name), rtol=1e-3, atol=1e-2
        )
    metrics, earlier = ((f / "metrics.json").read_text() for f in (run, SAVED))
    assert json.loads(metrics)["psnr"] == pytest.approx(json.loads(earlier)["psnr"], abs=0.01)
    assert set(json.loads(earlier)) <= set(json.loads(metrics))
