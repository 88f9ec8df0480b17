"""Devices of this machine for drawing, and why one is not used."""

import ctypes as ct
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

from ...errors import BackendError
from . import header
from .absence import cards_without_driver, why_no_device
from .denied import denied_reason
from .library import last_error, library, raise_status
from .verdict import DeviceVerdict, read_verdict, verdict_key

NOT_TESTED = "not tested yet"
"""State of a device without a verdict."""


@dataclass(frozen=True, kw_only=True)
class Device:
    """A device that Vulkan offers."""

    number: int
    """Number for `--device`."""
    name: str
    driver: str
    """Name and version of the driver."""
    kind: str
    """discrete, integrated, virtual, software or other."""
    memory_bytes: int
    memory_free_bytes: int | None
    """Bytes not in use by any program; None: unknown."""
    largest_buffer_bytes: int
    uuid: str
    """Hexadecimal."""
    vendor: int
    """PCI number."""
    device: int
    """PCI number."""
    driver_version: int
    """In the driver's own format."""
    api_version: str
    """Version of Vulkan, such as 1.3.230."""
    subgroup: int
    """Invocations of a subgroup."""
    workgroup: int
    """Most invocations of a workgroup."""
    shared_memory_bytes: int
    """Per workgroup."""
    missing: tuple[str, ...]
    """Required features that it lacks."""

    @property
    def is_software(self) -> bool:
        """Whether the CPU computes its pictures."""
        return self.kind == "software"

    @cached_property
    def denied(self) -> str:
        """Why it is on the list of denied drivers; empty: it is not."""
        return denied_reason(self.vendor, self.device, self.driver_version)

    @cached_property
    def key(self) -> dict[str, Any]:
        """All that its verdict depends on."""
        return verdict_key(
            uuid=self.uuid,
            driver=self.driver,
            driver_version=self.driver_version,
            subgroup=self.subgroup,
        )

    @property
    def verdict(self) -> DeviceVerdict | None:
        """Kept result of its self-test; None: not tested yet."""
        return read_verdict(self.key)

    @property
    def unusable(self) -> str:
        """Why it cannot even be tested, as a sentence; empty: it can."""
        if self.denied:
            return f"This driver is denied: {self.denied.rstrip('.')}."
        if self.missing:
            lacking = ", ".join(self.missing)
            return f"It lacks {lacking}; update its driver, or use the CPU."
        return ""

    @property
    def reason(self) -> str:
        """Why it is not used, as a sentence; empty: it is, after its self-test if there was none
        yet."""
        return self.unusable or failure_text(self.verdict)

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        verdict = self.verdict
        return asdict(self) | {
            "missing": list(self.missing),
            "denied": self.denied,
            "verdict": None if verdict is None else verdict.to_dict(),
            "reason": self.reason,
        }


def failure_text(verdict: DeviceVerdict | None) -> str:
    """Why a self-test was not passed, as a sentence; empty: passed, or there was none."""
    if verdict is None or verdict.passed:
        return ""
    what = verdict.problems[0].rstrip(".") if verdict.problems else "no reason given"
    return f"Its self-test failed: {what}. `gscore doctor --verify` repeats it."


@dataclass(frozen=True, kw_only=True)
class FoundDevices:
    """The devices of this machine."""

    devices: tuple[Device, ...] = ()
    """All that Vulkan offers, by number."""
    problems: tuple[str, ...] = ()
    """Sentences: why there is no device, or which card has no driver."""


def find_devices() -> FoundDevices:
    """List the devices, without opening one."""
    try:
        lib = library()
    except BackendError as error:
        return FoundDevices(problems=(f"This gscore cannot use graphics cards. {error}",))
    count = ct.c_int32(0)
    status = lib.gs_gpu_devices(None, 0, ct.byref(count))
    if status == header.UNSUPPORTED:
        return FoundDevices(problems=why_no_device(last_error()))
    try:
        raise_status(status)
        infos = (header.GpuInfoStruct * count.value)()
        raise_status(lib.gs_gpu_devices(infos, count.value, ct.byref(count)))
    except BackendError as error:
        return FoundDevices(problems=(str(error),))
    devices = tuple(_device(i, infos[i]) for i in range(min(len(infos), count.value)))
    if not devices:
        return FoundDevices(problems=why_no_device("Vulkan lists no device"))
    vendors = {device.vendor for device in devices if not device.is_software}
    return FoundDevices(devices=devices, problems=cards_without_driver(vendors))


def _device(number: int, info: Any) -> Device:
    major, minor, patch = info.api_version >> 22, info.api_version >> 12 & 0x3FF, info.api_version
    return Device(
        number=number,
        name=_text(info.name),
        driver=_text(info.driver),
        kind=header.KINDS[info.kind] if 0 <= info.kind < len(header.KINDS) else header.KINDS[0],
        memory_bytes=info.memory,
        memory_free_bytes=info.memory_free or None,
        largest_buffer_bytes=info.largest_buffer,
        uuid=bytes(info.uuid).hex(),
        vendor=info.vendor,
        device=info.device,
        driver_version=info.driver_version,
        api_version=f"{major}.{minor}.{patch & 0xFFF}",
        subgroup=info.subgroup,
        workgroup=info.workgroup,
        shared_memory_bytes=info.shared_memory,
        missing=tuple(part.strip() for part in _text(info.missing).split(",") if part.strip()),
    )


def _text(raw: bytes) -> str:
    return raw.decode("utf-8", "replace")
