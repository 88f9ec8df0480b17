"""Devices that compute on the CPU; oracles: the CPU's library, float64, and their own bits."""

from functools import cache
from typing import Any

import pytest

from tests.gpu.drivers import DRIVERS, Driver, result_of

ONE = DRIVERS[1]
each_driver = pytest.mark.parametrize("driver", DRIVERS, ids=lambda driver: driver.name)


@each_driver
def test_pictures_and_arithmetic_are_right(driver: Driver) -> None:
    """Oracle: each test of the self-test; one exponential in 997. Lavapipe's subgroups have a
    quarter of the bits of its vectors, in words."""
    found = result_of(driver, "print_problems(997)")
    assert found["problems"] == []
    if driver.width:
        assert found["subgroup"] == int(driver.width) // 32


@cache
def _bits(driver: Driver) -> list[str]:
    return result_of(driver, "print_bits(20)")["bits"]


@each_driver
def test_bits_repeat(driver: Driver) -> None:
    """Oracle: one hash of all pictures in 20 repeats."""
    assert len(_bits(driver)) == 1


def test_bits_do_not_depend_on_the_width_of_subgroups() -> None:
    """Oracle: lavapipe's other widths."""
    found = [_bits(driver) for driver in DRIVERS if driver.width]
    assert found.count(found[0]) == 3


def test_validation_layers_find_nothing() -> None:
    """Oracle: Vulkan's validation layer, whose errors fail the call that caused them."""
    found = result_of(ONE, "print_problems(99991)", GSCORE_GPU_CHECK="1")
    assert found["problems"] == []


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
    variables = {"GSCORE_GPU_FAULT": f"{fault}:1", "GSCORE_GPU_SECONDS": "1"}
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
