"""Device option of verbs that draw: the CPU or a graphics card."""

import argparse
import sys
from collections.abc import Callable

from ...quoting import quoted
from ...raster.gpu.choice import CPU, Chosen, choose, is_device, once_a_device
from ...raster.gpu.verification import Report
from ..parser import add_option
from ..terminal.status import Status, can_move, print_warnings


def add_device_option(parser: argparse.ArgumentParser, *, default: str = "auto") -> None:
    """Declare `--device`; `default`: for verbs that measure a device, which must be named."""
    add_option(
        parser,
        "--device DEVICE",
        "what draws: cpu, gpu (a graphics card), auto (a usable card or the CPU), or a number of "
        f"gscore doctor ({default})",
        _device,
        default=default,
    )


def _device(text: str) -> str:
    if not is_device(text):
        raise argparse.ArgumentTypeError(
            f"{quoted(text)} is not cpu, gpu, auto or a number listed by gscore doctor"
        )
    return text


def test_report(status: Status) -> Report:
    """Shows a self-test while it runs; where lines cannot be redrawn, a line at its begin."""
    if can_move(sys.stderr):
        return lambda sentence: status.show([sentence])
    return once_a_device(lambda sentence: status.print_line(f"{sentence}."))


def device_of(
    args: argparse.Namespace, *, cancel: Callable[[], bool] | None = None, warn: bool = True
) -> Chosen:
    """The device that the arguments name, tested first if it is new.

    Args:
        args: Arguments with `device`, and `quiet` if the verb has it.
        cancel: Returns whether a self-test is to stop.
        warn: Print its note as a warning.

    Raises:
        ConfigError: there is no such device.
        BackendError: it cannot be used.
        Cancelled: `cancel` returned True.
    """
    if args.device == "cpu":
        return CPU
    with Status(sys.stderr, quiet=getattr(args, "quiet", False)) as status:
        found = choose(args.device, report=test_report(status), cancel=cancel)
    if warn and found.note:
        print_warnings([found.note])
    return found
