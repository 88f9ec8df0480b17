"""Denied drivers: devices with known wrong pictures or crashes, as data."""

import sys
from dataclasses import dataclass

_ALL = (0, 0xFFFF_FFFF)


@dataclass(frozen=True, kw_only=True)
class DeniedDriver:
    """Devices of one vendor that are not used with some drivers."""

    vendor: int
    """PCI number of the vendor: 0x10DE NVIDIA, 0x1002 AMD, 0x8086 Intel."""
    devices: tuple[int, int] = _ALL
    """First and last PCI number of the devices."""
    drivers: tuple[int, int] = _ALL
    """First and last version of the driver, in the driver's own format."""
    system: str = ""
    """Value of sys.platform; empty: all systems."""
    reason: str
    """The fault and its remedy, as the end of a sentence."""


DENIED: tuple[DeniedDriver, ...] = ()
"""All known ones."""


def denied_reason(vendor: int, device: int, driver_version: int) -> str:
    """Why a device is never used with this driver; empty: it may be used."""
    for one in DENIED:
        if (
            one.vendor == vendor
            and one.devices[0] <= device <= one.devices[1]
            and one.drivers[0] <= driver_version <= one.drivers[1]
            and one.system in ("", sys.platform)
        ):
            return one.reason
    return ""
