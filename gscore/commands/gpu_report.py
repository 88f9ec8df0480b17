"""Report of `gscore doctor` on the graphics cards, for help with them: nothing private."""

import os
import re
from collections.abc import Callable, Mapping
from typing import Any

from ..errors import GsError
from ..raster.gpu.devices import Device, FoundDevices
from ..raster.gpu.gpu_raster import GpuRaster
from ..raster.gpu.library import library_hash
from ..raster.gpu.timing import timed_pictures, timing_view

_MACHINE = ("gscore", "platform", "python", "cpu", "cores", "memory_bytes")
"""Facts on the machine that are reported."""
_PRIVATE = ("uuid",)
"""Fields of a device that identify a single card."""
_VARIABLES = ("VK_", "LP_", "MESA_", "DRI_", "GSCORE_", "MVK_")
"""Beginnings of environment variables that change drivers; their names are listed, and not the
values, which contain paths."""
_FOLDERS = re.compile(r"(?<![\w.])(?:[A-Za-z]:)?[\\/](?:[^\\/\"'\n:;,]*[\\/])+")
"""The folders of an absolute path, whose names may have spaces."""
_SIZES = {True: ((5_000, 320),), False: ((100_000, 1000), (300_000, 1920))}
"""Splats and widths of the timed pictures and steps: on software devices, and on others."""
_REPEATS = {True: 2, False: 10}


def device_report(
    found: FoundDevices,
    machine: Mapping[str, Any],
    *,
    progress: Callable[[str], None] = lambda sentence: None,
) -> dict[str, Any]:
    """Machine, devices with their limits and verdicts, and times of their kernels, as JSON values.

    Args:
        found: The devices, tested before.
        machine: What `gscore doctor` found out about the machine.
        progress: Called with a sentence before each device.

    Returns:
        No paths, names of users or of the machine, serial numbers and values of variables.
    """
    devices = []
    for device in found.devices:
        progress(f"Measuring {device.name}")
        facts = {n: v for n, v in device.to_dict().items() if n not in _PRIVATE}
        devices.append(facts | _times(device))
    return _without_paths(
        {
            **{name: machine[name] for name in _MACHINE},
            "library": library_hash(),
            "variables": sorted(name for name in os.environ if name.startswith(_VARIABLES)),
            "problems": list(found.problems),
            "devices": devices,
        }
    )


def _without_paths(value: Any) -> Any:
    """JSON values with file names in place of the absolute paths in their texts."""
    if isinstance(value, dict):
        return {name: _without_paths(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_without_paths(one) for one in value]
    return _FOLDERS.sub("", value) if isinstance(value, str) else value


def _times(device: Device) -> dict[str, Any]:
    """Times of pictures, gradients and training steps on a device, or why there are none."""
    if device.reason:
        return {"times": [], "times_problem": device.reason}
    times, soft = [], device.is_software
    try:
        with GpuRaster(device.number) as raster:
            for count, width in _SIZES[soft]:
                made = timed_pictures(raster, count, width, repeats=_REPEATS[soft], gradients=True)
                times.append(made | _step_times(raster, count, width))
    except (GsError, MemoryError) as error:
        return {"times": times, "times_problem": str(error)}
    return {"times": times, "times_problem": ""}


def _step_times(raster: GpuRaster, count: int, width: int) -> dict[str, Any]:
    """Milliseconds of a training step, and of its kernels; empty without a usable torch."""
    try:
        from ..engine.gpu.engine import GpuEngine
        from ..engine.trial import step_seconds
    except (ImportError, OSError):
        return {}
    engine, view = GpuEngine(raster, name="", numerics=""), timing_view(width)
    size = {"splats": count, "sh_degree": 3, "width": view.width, "height": view.height}
    seconds = step_seconds(engine, **size)
    raster.profile(True)
    step_seconds(engine, **size, seconds=0)
    kernels = raster.kernel_times()
    raster.profile(False)
    engine.release()
    steps = max(kernels["learn"][1], 1)
    return {
        "step_ms": 1e3 * seconds,
        "step_kernels_ms": {n: total / steps for n, (total, calls) in kernels.items() if calls},
    }
