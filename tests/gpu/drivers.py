"""Drivers that compute on the CPU: four different devices for tests without a graphics card."""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import pytest

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Driver:
    """A driver, chosen by environment variables."""

    name: str
    width: str = ""
    """Bits of its vectors; empty: not its choice."""


DRIVERS = (
    *(Driver(f"lavapipe-{bits}", bits) for bits in ("128", "256", "512")),
    Driver("swiftshader"),
)
"""Mesa's with subgroups of 4, 8 and 16 invocations, and Google's."""
each_driver = pytest.mark.parametrize("driver", DRIVERS, ids=lambda driver: driver.name)


def required() -> bool:
    """Whether missing devices and tools are failures."""
    return os.environ.get("GSCORE_GPU_REQUIRED", "0") not in ("", "0")


def absent(sentence: str) -> NoReturn:
    """Skip the test; where GSCORE_GPU_REQUIRED is set, fail."""
    if required():
        pytest.fail(f"{sentence} GSCORE_GPU_REQUIRED requires it.")
    pytest.skip(sentence)


def variables_of(driver: Driver) -> dict[str, str]:
    """The environment of a driver's programs; skips the test if it is not installed."""
    found = {k: v for k, v in os.environ.items() if not k.startswith("GSCORE_GPU_FAULT")}
    if driver.name == "swiftshader":
        path = os.environ.get("GSCORE_SWIFTSHADER", "")
        if not Path(path).is_file():
            absent("GSCORE_SWIFTSHADER does not name libvk_swiftshader.so.")
        found["GSCORE_VULKAN_LOADER"] = path
    return found | ({"LP_NATIVE_VECTOR_WIDTH": driver.width} if driver.width else {})


def result_of(driver: Driver, code: str, **variables: str) -> Any:
    """The JSON value that a program prints in its last line; a missing device skips the test."""
    done = subprocess.run(
        [sys.executable, "-c", f"from tests.gpu.programs import *\n{code}"],
        capture_output=True,
        text=True,
        env=variables_of(driver) | {"PYTHONPATH": str(ROOT)} | variables,
        cwd=ROOT,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout.splitlines()[-1])
    if isinstance(result, dict) and "absent" in result:
        absent(result["absent"])
    return result
