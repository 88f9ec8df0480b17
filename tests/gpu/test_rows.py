"""Rows of a training on devices that compute on the CPU; oracle: the CPU engine's model."""

from functools import cache
from typing import Any

import pytest

from tests.gpu.drivers import DRIVERS, Driver, result_of

ONE = DRIVERS[1]
CODE = "from tests.gpu.row_programs import *\n"
CHECKS = (
    "columns",
    "frozen",
    "edits",
    "degrees",
    "clamps",
    "noise",
    "morton",
    "checkpoints",
    "ends",
)


@cache
def _found(driver: Driver, **variables: str) -> Any:
    return result_of(driver, f"{CODE}print_row_problems()", **variables)


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize("driver", DRIVERS, ids=lambda driver: driver.name)
def test_rows_are_those_of_the_cpu(driver: Driver, check: str) -> None:
    """Oracle: CpuModel after the same calls: equal bits of copies and edits, 1e-6 of logarithms and
    noise; a twin of the Morton keys in numpy; pictures of the same splats copied again."""
    assert _found(driver)["problems"][check] == []


def test_every_check_is_listed() -> None:
    """Oracle: the names of the program's results."""
    assert list(_found(ONE)["problems"]) == list(CHECKS)


def test_bits_of_rows_do_not_depend_on_the_width_of_subgroups() -> None:
    """Oracle: lavapipe's other widths."""
    assert len({_found(driver)["hash"] for driver in DRIVERS if driver.width}) == 1


def test_validation_and_poisoned_memory_find_nothing_in_rows() -> None:
    """Oracle: Vulkan's validation layer, whose errors fail the call that caused them, and the bits
    without GSCORE_GPU_CHECK, which fills memory in transit with a pattern."""
    found = result_of(ONE, f"{CODE}print_row_problems()", GSCORE_GPU_CHECK="1")
    assert found == _found(ONE)


def test_rows_that_do_not_fit_are_refused() -> None:
    """Oracle: the messages' numbers; after a growth that failed at its third table, the model is as
    before, and the same edit succeeds where there is memory."""
    found = result_of(ONE, f"{CODE}print_short_memory()")
    buffer, most, memory = found["messages"]
    assert "2288 MiB are needed" in buffer
    assert most.startswith("A device trains at most 35791394 splats with 16 SH coefficients")
    assert "MiB more" in memory and "MiB are in use here" in memory
    assert found["changed"] == found["after"] == []
