"""Oracle: the checks of the script that measures trainings on a card, on a device in software."""

import importlib
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.gpu.drivers import DRIVERS, ROOT, result_of, variables_of

ONE = DRIVERS[1]
PASSED = """
import json
from gscore.raster.gpu.devices import find_devices
from gscore.raster.gpu.verdict import DeviceVerdict, keep_verdict
found = find_devices()
for device in found.devices:
    keep_verdict(device.key, DeviceVerdict(passed=True))
print(json.dumps({} if found.devices else {"absent": " ".join(found.problems)}))
"""
"""Keeps a verdict, because the self-test takes longer and has tests of its own."""


def _measured(folder: Path, out: str, *options: str) -> tuple[int, Any, str]:
    """Exit code, figures and printed text of the script, copied out of the checkout."""
    command = [sys.executable, folder / "gpu_train.py", "--tiny", "-o", folder / out, *options]
    variables = variables_of(ONE) | {"XDG_CACHE_HOME": str(folder / "cache")}
    done = subprocess.run(command, capture_output=True, text=True, env=variables, cwd=folder)
    if not (folder / out).exists():
        return done.returncode, None, done.stderr
    found = json.loads((folder / out).read_text(encoding="utf-8"))
    return done.returncode, found, done.stdout


@pytest.mark.slow
def test_one_command_measures_a_card(tmp_path: Path) -> None:
    """Oracle: its exit code and files, where no folder is given; floors at the measured
    bandwidth."""
    result_of(ONE, PASSED, XDG_CACHE_HOME=str(tmp_path / "cache"))
    variables = variables_of(ONE) | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    variables |= {"PYTHON": sys.executable, "PYTHONPATH": str(ROOT)}
    script = ROOT / "tools" / "measure" / "gpu.sh"
    done = subprocess.run(
        [script, "--tiny"], capture_output=True, text=True, env=variables, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    out = tmp_path / "out" / "gpu"
    assert (out / "gpu.txt").read_text(encoding="utf-8") == done.stdout
    for name in ("forward", "train"):
        found = json.loads((out / f"{name}.json").read_text(encoding="utf-8"))
        assert found["ceilings"].keys() == {"bytes_a_second", "operations_a_second"}
        times = found["times"][0]
        floors = times["floors_ms"]
        assert floors.keys() == times["kernels_bytes"].keys()
        found_bytes = times["kernels_bytes"]["blend"] / floors["blend"] * 1e3
        assert found_bytes == pytest.approx(found["ceilings"]["bytes_a_second"])


@pytest.mark.slow
def test_the_measuring_script_compares_trainings_with_the_cpu(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: its exit code; its checks of another PSNR and of other bits, which fail; figures of
    another number of steps, which are refused."""
    for name in ("gpu_train.py", "gpu_forward.py"):
        shutil.copy(ROOT / "tools" / "measure" / name, tmp_path)
    result_of(ONE, PASSED, XDG_CACHE_HOME=str(tmp_path / "cache"))
    code, cpu, text = _measured(tmp_path, "cpu.json", "--device", "cpu")
    assert code == 0, text
    assert "times" not in cpu and "resumed" not in cpu

    code, found, text = _measured(tmp_path, "gpu.json", "--cpu", str(tmp_path / "cpu.json"))
    assert code == 0, text
    assert found["device"].startswith("gpu: ") and len(found["checks"]) == 5
    assert 0 < abs(found["trainings"][0]["psnr_difference"]) < 0.1
    assert found["resumed"]["changed_after"] == [4, 8]
    (times,) = found["times"]
    assert times["visible"] > 1000 and times["device_bytes"] > 2000 * 700
    assert times["kernels_ms"]["learn"] > 0 and times["host_ms"] > 0
    assert times["kernels_ms"].keys() >= times["kernels_bytes"].keys() >= {"blend_backward"}

    monkeypatch.syspath_prepend(tmp_path)
    checks = importlib.import_module("gpu_train").checks
    assert checks(found) == found["checks"] and all(found["checks"].values())
    training = found["trainings"][0]
    training["psnr_difference"] -= 0.2
    assert not checks(found)["toy: within 0.1 dB of the CPU"]
    training["same_bits"] = False
    assert list(checks(found).values()).count(False) == 2

    options = ("--steps", "13", "--cpu", str(tmp_path / "cpu.json"))
    code, found, text = _measured(tmp_path, "other.json", *options)
    assert code == 1 and "lacks trainings of toy with 13 steps" in text
