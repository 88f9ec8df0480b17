"""A device of this machine for processes that Blender starts."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.gpu.drivers import ROOT, absent

_CODE = """
from gscore.raster.gpu.devices import find_devices
from gscore.raster.gpu.verdict import DeviceVerdict, keep_verdict
for device in find_devices().devices[:1]:
    keep_verdict(device.key, DeviceVerdict(passed=True))
    print(device.uuid, device.name)
"""


def passed_device(python: str, cache: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, str]:
    """UUID and name of the first Vulkan device, as one that has passed its self-test; without one
    the test is skipped.

    Args:
        python: The Python of the process that will use it.
        cache: Folder for the verdict, in place of the user's.
        monkeypatch: Lets processes find devices, also where Blender itself is kept from them.
    """
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    if os.environ.get("VK_LOADER_DRIVERS_DISABLE") == "*":
        monkeypatch.delenv("VK_LOADER_DRIVERS_DISABLE")
    command = [python, "-c", _CODE]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    if not (found := done.stdout.strip()):
        absent("There is no Vulkan device.")
    uuid, name = found.split(maxsplit=1)
    return uuid, name
