"""Loss of a picture on devices that compute on the CPU; oracles: the CPU's, float64, its own
bits."""

from functools import cache
from typing import Any

import pytest

from tests.gpu.drivers import DRIVERS, Driver, result_of

ONE = DRIVERS[1]
each_driver = pytest.mark.parametrize("driver", DRIVERS, ids=lambda driver: driver.name)


@cache
def _ran(driver: Driver) -> dict[str, Any]:
    return _result(driver, "print_all()")


def _result(driver: Driver, code: str, **variables: str) -> Any:
    return result_of(driver, f"from tests.gpu.loss_programs import *\n{code}", **variables)


@each_driver
def test_values_and_gradients_are_those_of_the_cpu_and_of_float64(driver: Driver) -> None:
    """Oracle: the CPU engine's loss of a step, and the reference by autograd, for all mask modes,
    gains, sizes, weights and terms; a loss with another weight is noticed."""
    found = _ran(driver)
    assert found["problems"] == []
    assert all(found["noticed"])


@each_driver
def test_bits_repeat_and_do_not_depend_on_submissions(driver: Driver) -> None:
    """Oracle: one hash per case, whether all rows of tiles are in a submission, one or two."""
    found = _ran(driver)["bits"]
    assert found and all(len(hashes) == 1 for hashes in found)


def test_bits_do_not_depend_on_the_width_of_subgroups() -> None:
    """Oracle: lavapipe's other widths."""
    found = [_ran(driver)["bits"] for driver in DRIVERS if driver.width]
    assert found.count(found[0]) == 3


def test_validation_layers_find_nothing_and_memory_is_not_read_before_written() -> None:
    """Oracle: the layers, whose errors fail the call, and the bits without GSCORE_GPU_CHECK, which
    fills all buffers with a pattern."""
    found = _result(ONE, "print_bits()", GSCORE_GPU_CHECK="1")
    assert [[one] for one in found] == _ran(ONE)["bits"]


@each_driver
def test_slopes(driver: Driver) -> None:
    """Oracle: central differences of the loss itself."""
    found = _ran(driver)["slopes"]
    for derivative, difference in found:
        assert abs(derivative) > 0.01
        assert derivative == pytest.approx(difference, rel=2e-3)


@each_driver
def test_what_is_not_finite_or_absurd_is_not_sane(driver: Driver) -> None:
    """Oracle: whether the CPU's loss is finite; and a mean squared error of some 1e5^2 / (33 17 3),
    which is absurd and finite."""
    for value, mode, sane, infinite, true in _ran(driver)["insane"]:
        assert sane == (value == "0.5"), (value, mode)
        assert infinite == true, (value, mode)
        assert true == (value not in ("0.5", "100000.0")), (value, mode)


@each_driver
def test_pictures_in_which_digits_are_lost(driver: Driver) -> None:
    """Oracle: the definition, for a picture that is its photo; float64, for a bright wall, and for
    a dot, whose least gradients reach into the next tiles."""
    found = _ran(driver)
    ssim, l1, mse, loss, largest = found["identical"]
    assert (ssim, l1, mse, loss) == (1.0, 0.0, 0.0, 0.0) and largest < 1e-9
    assert found["bright"][0] == pytest.approx(found["bright"][1], abs=2e-6)
    error, least = found["reach"]
    assert error < 1e-10 < 1e-9 < least


def test_bad_input_is_named() -> None:
    """Oracle: the messages."""
    found = _result(ONE, "print_refusals()")
    words = "alpha", "mask_mode", "mask_mode", "gain", "ssim_weight", "rows_at_once"
    for message, word in zip(found, (*words, "blur", "target", "mask"), strict=True):
        assert word in message.lower()
