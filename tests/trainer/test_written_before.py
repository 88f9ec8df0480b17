"""Files of an earlier gscore; oracle: what is known of the run that wrote them.

`written_before/` holds config.json (its capture renamed) and the checkpoint of four steps on the
toy capture: `--iterations 4 --max-splats 160 --sh-degree 0 --strategy mcmc --seed 3 --test-every 4
--without rare-sh --background white --checkpoint-seconds 0`.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gscore.commands import main
from gscore.config import Background, Skip, Stereo, Strategy
from gscore.config_file import load_config
from gscore.io.ply.splats import read_ply
from gscore.presets import PRESETS
from gscore.trainer.files import checkpoint
from gscore.trainer.files.run_folder import RunFolder

BEFORE = Path(__file__).parent / "written_before"
DATA, TRAIN = PRESETS["normal"](Path("/captures/toy"))
WANTED = (
    replace(DATA, eval=True, test_every=4),
    replace(
        TRAIN,
        steps_a_photo=0,  # the preset had neither this limit
        stereo=Stereo.MISSING,  # nor stereo points in addition to those of a capture
        opaque_weight=0.0,  # nor this weight
        drop_rate=0.0,  # and had no dropout
        drop_below=0.0,
        ensemble=1,  # of one model
        ensemble_below=0.0,
        iterations=4,
        max_splats=160,
        sh_degree=0,
        strategy=Strategy.MCMC,
        seed=3,
        without=(Skip.RARE_SH,),
        background=Background.WHITE,
        checkpoint_seconds=0.0,
    ),
)


def test_a_config_opens() -> None:
    """Oracle: the preset and the options of the command line that wrote it."""
    assert load_config(BEFORE / "config.json") == WANTED


def test_a_checkpoint_opens() -> None:
    """Oracle: the same options, and the number of steps."""
    found = checkpoint.load(BEFORE / "step_00000004.safetensors")
    assert (found.config, found.steps) == (WANTED[1], 4)


def test_a_training_goes_on_from_them(capture: Path, tmp_path: Path) -> None:
    """Oracle: a run with the same options begun today, up to rounding of another machine; photos
    with one exposure had no gains then."""
    options = ["--config", str(BEFORE / "config.json"), "--quiet"]
    old, new = tmp_path / "old", tmp_path / "new"
    start = ["--start-checkpoint", str(BEFORE / "step_00000004.safetensors"), "--iterations", "8"]
    assert main(["train", str(capture), "-o", str(old), *options, *start]) == 0
    assert main(["train", str(capture), "-o", str(new), *options, "--exposure", "off"]) == 0
    assert main(["train", "-o", str(new), "--resume", "--iterations", "8", "--quiet"]) == 0
    assert RunFolder(old).checkpoints()[-1].name == RunFolder(new).checkpoints()[-1].name
    a, b = (read_ply(folder / "point_cloud.ply") for folder in (old, new))
    np.testing.assert_allclose(a.means, b.means, atol=1e-4)
    np.testing.assert_allclose(a.opacities, b.opacities, atol=1e-3)
