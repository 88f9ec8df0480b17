"""Ranks of torchrun with a device each; oracle: the splats of one process on another device."""

import json
from pathlib import Path

import pytest

from tests.gpu.drivers import DRIVERS, result_of, variables_of
from tests.trainer.distributed.start_ranks import start

FIRST, OTHER, LAST = (driver for driver in DRIVERS if driver.width)
RUN = """
import os, runpy, sys
os.environ["LP_NATIVE_VECTOR_WIDTH"] = sys.argv.pop(1)
sys.argv[0] = "gscore"
runpy.run_module("gscore", run_name="__main__")
"""
SHORT = ("--preset", "preview", "--iterations", "4", "--device", "gpu", "--quiet")


def test_ranks_train_blocks_on_a_device_each(
    gscore, capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ranks with vectors of 128 and 512 bits, and a process with 256: the same bits."""
    cache = str(tmp_path / "cache")
    for driver in (FIRST, OTHER, LAST):
        result_of(driver, "keep_passed()", XDG_CACHE_HOME=cache)
    monkeypatch.setenv("XDG_CACHE_HOME", cache)
    blocks = tmp_path / "blocks"
    assert gscore("split", capture, "-o", blocks, "--blocks", "2", "--quiet")[0] == 0
    found = []
    for drivers in ((FIRST, LAST), (OTHER,)):
        runs = tmp_path / f"runs{len(drivers)}"
        for name, value in variables_of(drivers[0]).items():
            monkeypatch.setenv(name, value)
        words = ["train", blocks, "-o", runs, *SHORT]
        ranks = start(*(["-c", RUN, driver.width, *words] for driver in drivers))
        assert [rank.code for rank in ranks] == [0] * len(drivers), ranks
        for path in runs.glob("*/metrics.json"):
            isa = json.loads(path.read_text(encoding="utf-8"))["machine"]["isa"]
            assert isa.startswith("gpu: ")
        found.append({f.parent.name: f.read_bytes() for f in runs.glob("*/point_cloud.ply")})
    assert found[0] == found[1] and len(found[0]) == 2
