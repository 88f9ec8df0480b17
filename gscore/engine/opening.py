"""Opening of the engine that a training names: the CPU, or a graphics card that passed its test."""

from collections.abc import Callable
from functools import partial
from typing import Any

from ..raster.gpu.choice import Chosen, choose
from ..raster.gpu.gpu_raster import GpuRaster
from ..raster.gpu.verification import distrust
from .base import Engine
from .cpu.engine import CpuEngine
from .gpu.engine import CARD_COST, SOFTWARE_COST, GpuEngine


def open_engine(
    device: str,
    *,
    threads: int = 0,
    report: Callable[[str], None] | None = None,
    cancel: Callable[[], bool] | None = None,
) -> tuple[Engine[Any], str]:
    """Open the engine of a device.

    Args:
        device: As `--device`: `cpu`, `gpu`, `auto`, or the number of a device.
        threads: CPU threads; 0: all cores.
        report: Receives a sentence on a self-test while it runs.
        cancel: Returns whether a self-test is to stop.

    Returns:
        The engine, and a sentence for the user on the choice; empty: nothing to mention.

    Raises:
        ConfigError: there is no such device.
        BackendError: the device cannot be used, with the reason.
        Cancelled: `cancel` returned True.
    """
    chosen = choose(device, report=report, cancel=cancel)
    return engine_of(chosen, threads=threads), chosen.note


def engine_of(chosen: Chosen, *, threads: int = 0) -> Engine[Any]:
    """The engine of a chosen device, opened for it alone."""
    if chosen.device is None:
        return CpuEngine(threads=threads)
    is_card = not chosen.device.is_software
    return GpuEngine(
        GpuRaster(chosen.device.number),
        name=chosen.device.name,
        numerics=chosen.identity,
        cost=CARD_COST if is_card else SOFTWARE_COST,
        is_card=is_card,
        on_wrong=partial(distrust, chosen.device),
    )
