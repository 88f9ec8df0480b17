"""Self-test of a device, the program of a child process: `python -m gscore.raster.gpu.self_test N`.

It prints JSON lines: what it is doing, and at the end the verdict. Optional arguments are the UUID
that the device must have, and the seconds after which the process ends; with these it also ends
with its standard input, so that a test does not survive the program that wants its result.
"""

import json
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from ...errors import GsError
from .devices import find_devices
from .gpu_raster import GpuRaster
from .library import DeviceMemoryError, DeviceTimeoutError
from .self_test_arithmetic import arithmetic_checks
from .self_test_gradients import gradient_checks
from .self_test_pictures import picture_checks
from .self_test_training import training_checks

_ENDED = 3
"""Exit code of a test that was ended."""


@dataclass(frozen=True)
class Check:
    """One test of a device."""

    name: str
    """Subject of the test, a few words."""
    run: Callable[[GpuRaster], tuple[list[str], dict[str, Any]]]
    """Returns the problems, as parts of sentences, and the figures by name."""


def checks() -> Iterator[Check]:
    """All tests of a device, the quick ones first."""
    for found in (picture_checks, gradient_checks, training_checks, arithmetic_checks):
        yield from (Check(name, run) for name, run in found())


def self_test(number: int, uuid: str, show: Callable[[str], None]) -> dict[str, Any]:
    """Test a device.

    Args:
        number: Its number.
        uuid: Its UUID; empty: any.
        show: Receives the name of each test as it begins.

    Returns:
        JSON values: `passed`, `problems` and `figures`; and `lasting`: a repetition would have the
        same result.
    """
    lasting = True
    problems: list[str] = []
    figures: dict[str, Any] = {}
    began = time.perf_counter()
    show("finding the device")
    there = {device.number: device for device in find_devices().devices}
    if number not in there or uuid not in ("", there[number].uuid):
        problems.append(f"another process finds another device {number}")
        lasting = False
    else:
        show("compiling the programs")
        try:
            with GpuRaster(number) as raster:
                figures["compile_seconds"] = round(time.perf_counter() - began, 3)
                for check in checks():
                    show(check.name)
                    found, measured = check.run(raster)
                    problems += [f"{check.name}: {one}" for one in found]
                    figures |= measured
        except GsError as error:
            lasting = not isinstance(error, DeviceMemoryError | DeviceTimeoutError)
            problems.append(str(error))
    figures["seconds"] = round(time.perf_counter() - began, 3)
    passed = not problems
    return {"passed": passed, "problems": problems, "figures": figures, "lasting": lasting}


def end_in_time(seconds: float) -> None:
    """End this process after some seconds, and with its standard input, by threads that also run
    while a driver computes."""
    timer = threading.Timer(seconds, os._exit, (_ENDED,))
    timer.daemon = True
    timer.start()
    threading.Thread(target=_end_with_input, daemon=True).start()


def _end_with_input() -> None:
    while os.read(0, 4096):
        pass
    os._exit(_ENDED)


def main(arguments: list[str]) -> int:
    """Test the device with the number of the first argument, and print the verdict."""

    def write(message: dict[str, Any]) -> None:
        sys.stdout.write(f"{json.dumps(message)}\n")
        sys.stdout.flush()

    uuid = arguments[1] if len(arguments) > 1 else ""
    if len(arguments) > 2:
        end_in_time(float(arguments[2]))
    write(self_test(int(arguments[0]), uuid, lambda what: write({"doing": what})))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
