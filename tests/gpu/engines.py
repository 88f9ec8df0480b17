"""Engines on drivers that compute on the CPU. Apart from `drivers`, which Blender's Python loads
too: it has no torch."""

from gscore.engine.gpu.engine import GpuEngine
from gscore.raster.gpu.devices import find_devices
from gscore.raster.gpu.gpu_raster import GpuRaster
from tests.gpu.drivers import absent


def software_engine() -> GpuEngine:
    """An engine on the first device of this machine; skips the test if there is none."""
    found = find_devices()
    if not found.devices:
        absent(" ".join(found.problems))
    device = found.devices[0]
    return GpuEngine(GpuRaster(device.number), name=device.name, numerics=f"gpu: {device.name}")
