"""Devices that compute on the CPU; oracles: the CPU's library, float64, and their own bits."""

import json
import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from tests.gpu.drivers import DRIVERS, ROOT, Driver, absent, each_driver, result_of, variables_of

ONE = DRIVERS[1]
LAYER = "libVkLayer_khronos_validation.so"


@cache
def _ran(driver: Driver) -> Any:
    repeats = 8 if driver.width else 4  # SwiftShader is slow
    return result_of(driver, f"print_all(997, {repeats})")


@each_driver
def test_pictures_and_arithmetic_are_right(driver: Driver) -> None:
    """Oracle: each test of the self-test; one exponential in 997. Lavapipe's subgroups have a
    quarter of the bits of its vectors, in words."""
    found = _ran(driver)
    assert found["problems"] == []
    if driver.width:
        assert found["subgroup"] == int(driver.width) // 32


@each_driver
def test_bits_repeat(driver: Driver) -> None:
    """Oracle: one hash of all pictures and gradients in all repeats."""
    assert len(_ran(driver)["bits"]) == 1


@pytest.mark.slow
@each_driver
def test_bits_repeat_twenty_times(driver: Driver) -> None:
    """Oracle: the one hash of fewer repeats."""
    assert result_of(driver, "print_bits(20)")["bits"] == _ran(driver)["bits"]


def test_bits_do_not_depend_on_the_width_of_subgroups() -> None:
    """Oracle: lavapipe's other widths."""
    found = [_ran(driver)["bits"] for driver in DRIVERS if driver.width]
    assert found.count(found[0]) == 3


@pytest.mark.parametrize("layer", ["system", "chromium"])
def test_validation_layers_find_nothing(layer: str, tmp_path: Path) -> None:
    """Oracle: two versions of Vulkan's validation layer, whose errors fail the call that caused
    them."""
    variables = {"GSCORE_GPU_CHECK": "1"}
    if layer == "chromium":
        library = Path(os.environ.get("GSCORE_SWIFTSHADER", "")).parent / LAYER
        if not library.is_file():
            absent(f"{LAYER} is not in the folder of GSCORE_SWIFTSHADER.")
        manifest = {"name": "VK_LAYER_KHRONOS_validation", "type": "GLOBAL"}
        manifest |= {"library_path": str(library), "api_version": "1.4.0"}
        manifest |= {"implementation_version": "1", "description": "validation"}
        text = json.dumps({"file_format_version": "1.2.0", "layer": manifest})
        (tmp_path / "layer.json").write_text(text, encoding="utf-8")
        variables["VK_LAYER_PATH"] = str(tmp_path)
    found = result_of(ONE, "print_problems(99991)", **variables)
    assert found["problems"] == []


def test_bits_do_not_depend_on_what_memory_contains() -> None:
    """Oracle: the bits without GSCORE_GPU_CHECK, which fills all buffers with a pattern before each
    draw."""
    assert result_of(ONE, "print_bits(2)", GSCORE_GPU_CHECK="1")["bits"] == _ran(ONE)["bits"]


@each_driver
def test_blending_weights_are_those_of_the_cpu(driver: Driver) -> None:
    """Oracle: the CPU's, which are gradients of a picture; kernels without a count did not run."""
    found = _ran(driver)["weights"]
    assert found["difference"] < 1e-5
    kernels = set(found["kernels"])
    assert not kernels or kernels >= {"project", "sort_scatter", "blend", "weights"}


def test_the_measuring_script_runs(tmp_path: Path) -> None:
    """Oracle: its exit code, which compares pictures with the CPU's, and the names of its figures;
    it is copied out of the checkout."""
    out = tmp_path / "gpu.json"
    script = shutil.copy(ROOT / "tools" / "measure" / "gpu_forward.py", tmp_path)
    command = [sys.executable, "-P", script, "--tiny"]
    variables = variables_of(ONE) | {"XDG_CACHE_HOME": str(tmp_path)}
    result_of(ONE, "keep_passed()", XDG_CACHE_HOME=str(tmp_path))
    done = subprocess.run(
        [*command, "-o", out], capture_output=True, text=True, env=variables, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(out.read_text(encoding="utf-8"))
    assert len(found["pictures"]) == 4 and len(found["times"]) == 1
    times = found["times"][0]
    assert times["kernels_ms"]["blend"] > 0
    assert times["kernels_ms"].keys() >= times["kernels_bytes"].keys() == times["floors_ms"].keys()
    assert min(found["ceilings"].values()) > 0 and "pictures/s" in done.stdout


@pytest.mark.parametrize(
    ("fault", "error", "usable"),
    [
        ("lost", "DeviceLostError", False),
        ("oom", "DeviceMemoryError", True),
        ("hang", "DeviceTimeoutError", False),
    ],
)
def test_injected_faults_are_errors(fault: str, error: str, usable: bool) -> None:
    """Oracle: the class of the error; the device opened again draws the CPU's picture."""
    variables = {"GSCORE_GPU_FAULT": f"{fault}:1"}
    found: dict[str, Any] = result_of(ONE, "print_draw_error()", **variables)
    assert found["error"][0] == error and found["error"][1].endswith("`--device cpu`.")
    assert (found["again"] == "") == usable and found["difference"] < 1e-4


def test_a_wrong_picture_fails_the_self_test() -> None:
    """Oracle: the fault that changes the first picture, and the sentence on it."""
    found = result_of(ONE, "print_problems(99991)", GSCORE_GPU_FAULT="wrong:1")
    assert any("changes when it is drawn again" in problem for problem in found["problems"])


def test_a_self_test_passes(tmp_path) -> None:
    """Oracle: the whole program that makes a verdict, run as `doctor` runs it."""
    code = (
        "import json\n"
        "from gscore.raster.gpu.devices import find_devices\n"
        "from gscore.raster.gpu.verification import verified\n"
        "found = find_devices()\n"
        "made = verified(found.devices[0], seconds=500).to_dict() if found.devices else\\\n"
        "    {'absent': ' '.join(found.problems)}\n"
        "print(json.dumps(made))"
    )
    found = result_of(ONE, code, XDG_CACHE_HOME=str(tmp_path))
    assert found["problems"] == [] and found["passed"]
    assert 0 < found["figures"]["exp2_error"] <= 2.5e-7
    assert len(list(tmp_path.rglob("*.json"))) == 1


def test_a_forked_process_opens_its_own() -> None:
    """Oracle: the CPU's picture in a child of a process that has drawn."""
    assert result_of(ONE, "print_forked()") == {"parent": 0, "child": 0}
