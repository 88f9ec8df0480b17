"""Memory for large models; oracle: the system's count of this process, and three times the size of
the model."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from gscore.formats import write_splat_file

from .conftest import MakeModel

if not Path("/proc/self/clear_refs").exists():
    pytest.skip("the system counts no peaks", allow_module_level=True)

COUNT, FLOATS = 1_000_000, 59
"""So large that costs that are constant for any model, palettes and blocks of rows, matter
little."""
MODEL = COUNT * FLOATS * 4 / 1e6
"""MB of a model of degree 3 in memory."""
CHILD = """
import gc, json, resource, sys
from pathlib import Path
from gscore.formats import read_splat_file, write_splat_file

def status(key):
    return int(Path("/proc/self/status").read_text().split(key)[1].split()[0]) / 1024

small, large, written = sys.argv[1:]
kept = read_splat_file(small).splats
write_splat_file(written, kept)  # what libraries take by themselves
gc.collect()
Path("/proc/self/clear_refs").write_text("5")
before = status("VmRSS:")
kept = read_splat_file(large).splats
read = status("VmHWM:") - before
gc.collect()
Path("/proc/self/clear_refs").write_text("5")
before = status("VmRSS:")
write_splat_file(written, kept)
print(json.dumps([read, status("VmHWM:") - before]))
"""
ENDINGS = (".ply", ".compressed.ply", ".spz", ".sog", ".splat", ".glb", ".spz.glb", ".usdc")


@pytest.mark.slow
@pytest.mark.parametrize("ending", ENDINGS)
def test_three_times_the_model_is_enough(
    ending: str, make_model: MakeModel, tmp_path: Path
) -> None:
    """Oracle: the factor in the first line of this module; the model is counted in both."""
    if ending == ".usdc":
        pytest.importorskip("pxr.UsdVol")
    small, large, written = (tmp_path / f"{name}{ending}" for name in ("small", "large", "written"))
    write_splat_file(small, make_model(50))
    write_splat_file(large, make_model(COUNT))
    command = [sys.executable, "-c", CHILD, str(small), str(large), str(written)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    read, write = json.loads(done.stdout)
    assert read < 3 * MODEL, f"{read:.0f} MB to read {MODEL:.0f}"
    assert write + MODEL < 3 * MODEL, f"{write:.0f} MB beyond {MODEL:.0f} to write them"
