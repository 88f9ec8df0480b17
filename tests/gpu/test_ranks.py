"""Ranks of torchrun with a device each; oracle: the splats of one process on another device."""

import json
from pathlib import Path

import pytest

from tests.gpu.drivers import DRIVERS, result_of, variables_of
from tests.trainer.distributed.start_ranks import Ended, start

FIRST, OTHER, LAST = (driver for driver in DRIVERS if driver.width)
RUN = """
import os, runpy, sys
os.environ["LP_NATIVE_VECTOR_WIDTH"], os.environ["GSCORE_GPU_FAULT"] = sys.argv.pop(1).split(",")
sys.argv[0] = "gscore"
runpy.run_module("gscore", run_name="__main__")
"""
SHORT = ("--preset", "preview", "--iterations", "4", "--device", "gpu", "--quiet")


def trained(words: list, *widths_and_faults: str) -> list[Ended]:
    """`gscore train` on a rank for each pair of a width and a fault."""
    return start(*(["-c", RUN, pair, *words] for pair in widths_and_faults))


def splats_in(runs: Path) -> dict[str, bytes]:
    """PLY of each block that was trained, all on devices."""
    for path in runs.glob("*/metrics.json"):
        isa = json.loads(path.read_text(encoding="utf-8"))["machine"]["isa"]
        assert isa.startswith("gpu: ")
    return {file.parent.name: file.read_bytes() for file in runs.glob("*/point_cloud.ply")}


def test_ranks_train_blocks_on_a_device_each(
    gscore, capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ranks with vectors of 128 and 512 bits, and a process with 256: the same bits; also where one
    device is lost, which ends its rank with a sentence, and the run is resumed."""
    cache = str(tmp_path / "cache")
    for driver in (FIRST, OTHER, LAST):
        result_of(driver, "keep_passed()", XDG_CACHE_HOME=cache)
    monkeypatch.setenv("XDG_CACHE_HOME", cache)
    blocks = tmp_path / "blocks"
    assert gscore("split", capture, "-o", blocks, "--blocks", "2", "--quiet")[0] == 0
    for name, value in variables_of(FIRST).items():
        monkeypatch.setenv(name, value)
    alone, both, lost = (tmp_path / name for name in ("alone", "both", "lost"))
    good = f"{FIRST.width},", f"{LAST.width},"
    for runs, used in ((alone, (f"{OTHER.width},",)), (both, good)):
        ranks = trained(["train", blocks, "-o", runs, *SHORT], *used)
        assert [rank.code for rank in ranks] == [0] * len(used), ranks
    expected = splats_in(alone)
    assert splats_in(both) == expected and len(expected) == 2
    words = ["train", blocks, "-o", lost, *SHORT]
    ranks = trained(words, good[0], f"{LAST.width},lost:s3")
    assert [rank.code for rank in ranks] == [2, 2]
    assert "Rank 1 " in ranks[0].err and " is lost " in ranks[0].err and not ranks[1].err
    assert len(splats_in(lost)) == 1
    assert trained([*words, "--resume"], good[1])[0].code == 0
    assert splats_in(lost) == expected
