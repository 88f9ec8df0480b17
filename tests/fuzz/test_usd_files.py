"""Damaged USD files, read by forks of one process; oracle: one of our errors or a good result, or
an end by a signal with a sentence in gscore."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("pxr.UsdVol")
if not hasattr(os, "fork") or not Path("/proc/self/statm").exists():
    pytest.skip("the attack forks, and asks the system for its memory", allow_module_level=True)

ROOT = Path(__file__).parents[2]
BROKEN = """
import importlib, sys
from pathlib import Path
tool = importlib.import_module("tools.break.usd_files")
whole, tool._KEPT = tool.read_usd, Path(sys.argv[1])
def read(path):
    number = path.stem
    if number == "7":
        raise IndexError("a fault of the reader")
    if number == "9":
        import os; os.kill(os.getpid(), 9)
    if number == "11":
        bytearray(1 << 40)
    return whole(path)
tool.read_usd = read
print(tool.attack("usda", 15, 4))
"""


def _run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )


def test_damaged_usd() -> None:
    """Oracle: the module's."""
    done = _run("-m", "tools.break.usd_files", "150")
    assert done.returncode == 0, done.stdout + done.stderr
    assert [line.split(":")[0] for line in done.stdout.splitlines()] == ["usda", "usdc", "usdz"]
    assert all(": 150 files, " in line for line in done.stdout.splitlines())


def test_faults_are_found(tmp_path: Path) -> None:
    """Oracle: a reader that fails at three files in three ways; each is kept, others are read."""
    done = _run("-c", BROKEN, str(tmp_path))
    reported = done.stdout.splitlines()
    assert reported[-1] == "False" and "3 faults" in reported[-2], done.stdout + done.stderr
    numbers = {path.name.split("-")[2] for path in tmp_path.iterdir()}
    assert numbers == {"7", "9", "11"}
    (said,) = tmp_path.glob("*-7-*.txt")
    assert "a fault of the reader" in said.read_text()
