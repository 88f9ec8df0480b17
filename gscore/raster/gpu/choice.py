"""Choice of the device that draws, and the CPU where it fails."""

import logging
import os
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass

from ...errors import BackendError, ConfigError
from .. import _native
from ..buffers import Array
from ..request import Frustum, Settings
from .absence import no_automatic_card
from .devices import Device, FoundDevices, failure_text, find_devices
from .gpu_raster import GpuRaster, opened
from .library import library_hash
from .verification import Report, verified

_log = logging.getLogger(__name__)
_ORDER = ("discrete", "integrated", "virtual", "other")
"""Kinds of real devices, best first."""
_UUID = re.compile("[0-9a-f]{32}")


def is_device(text: str) -> bool:
    """Whether a text has the form of a value of `--device`, see `choose`."""
    number = text.isascii() and text.isdigit()
    return text in ("cpu", "gpu", "auto") or number or _UUID.fullmatch(text) is not None


@dataclass(kw_only=True, eq=False)
class Chosen:
    """The device that draws."""

    device: Device | None
    """None: the CPU."""
    note: str = ""
    """A sentence for the user on the choice; empty: nothing to mention."""
    reason: str = ""
    """Why `auto` chose the CPU, as a sentence, also where there is nothing to mention."""
    fallback: bool = False
    """Whether the CPU continues after an error of the device."""
    failed: Device | None = None
    """The device that drew before the CPU; None: the CPU did not continue."""

    @property
    def name(self) -> str:
        """Name for tables and JSON: `cpu`, or the name of the device; both if it has failed."""
        return self._then([one.name for one in (self.failed, self.device) if one], "cpu")

    @property
    def identity(self) -> str:
        """Identity of the bits of pictures: the CPU's instruction set, or device, driver and the
        first digits of the library's hash; both if the device has failed."""
        library = library_hash()[:8]
        used = [one for one in (self.failed, self.device) if one]
        return self._then(
            [f"gpu: {one.name}, {one.driver}, library {library}" for one in used], _native.isa()
        )

    def _then(self, used: list[str], cpu: str) -> str:
        return ", then ".join(used if self.device else [*used, cpu])

    def lend(self) -> AbstractContextManager[_native.Raster | GpuRaster]:
        """The workspace that draws, for the duration of a block.

        Raises:
            BackendError: the device cannot be opened.
        """
        return _native.pool.lend() if self.device is None else opened(self.device).lend()

    def release(self) -> None:
        """Free the device's memory of kept splats; nothing on the CPU."""
        if self.device is not None:
            opened(self.device).release_all()

    def forward(
        self,
        splats: Sequence[Array],
        view: Frustum,
        settings: Settings,
        pictures: Mapping[str, Array],
        *,
        keep: bool = False,
    ) -> dict[str, float]:
        """Draw, on the CPU if the device fails and `fallback` is set.

        Args:
            splats: `PARAMETERS`, in their order.
            view: Camera and picture size.
            settings: Render settings.
            pictures: Output arrays, by the names of gs_image.
            keep: The arrays will not change, so that the device may keep its copy of them.

        Returns:
            Counts and milliseconds by name: `stats` of the workspace.

        Raises:
            BackendError: the device failed; its subclasses are listed in `GpuRaster.forward`.
            ShapeError: an array or a setting is invalid.
            Cancelled: `settings.cancel` was set.
        """
        try:
            return self._forward(splats, view, settings, pictures, keep=keep)
        except BackendError as error:
            if not self.fall_back(error):
                raise
            return self._forward(splats, view, settings, pictures, keep=keep)

    def fall_back(self, error: BackendError) -> bool:
        """Change to the CPU after an error of the device, with a warning; returns False where
        `fallback` does not allow that."""
        if self.device is None or not self.fallback:
            return False
        _log.warning("The CPU draws from here on, because %s failed: %s", self.name, error)
        self.device, self.failed = None, self.device
        return True

    def raster(self) -> GpuRaster | None:
        """The open device; None: the CPU.

        Raises:
            BackendError: it cannot be opened.
        """
        return None if self.device is None else opened(self.device)

    def _forward(
        self,
        splats: Sequence[Array],
        view: Frustum,
        settings: Settings,
        pictures: Mapping[str, Array],
        *,
        keep: bool,
    ) -> dict[str, float]:
        with self.lend() as raster:
            if keep and isinstance(raster, GpuRaster):
                raster.keep(splats, settings)
            raster.forward(splats, view, settings, pictures)
            return raster.stats()


CPU = Chosen(device=None)
"""The CPU; no library for graphics cards is loaded for it."""


def choose(
    device: str,
    *,
    report: Report | None = None,
    cancel: Callable[[], bool] | None = None,
    find: Callable[[], FoundDevices] = find_devices,
) -> Chosen:
    """Choose by the value of `--device`. A device is tested first if it has no verdict yet.

    Args:
        device: `cpu`; `gpu`: a graphics card, for ranks of torchrun in turn where there are several
            of the best kind, or a software device if there is nothing else;
            `auto`: a graphics card, or the CPU, for which no library is loaded where there is no
            card; the number of a device in `gscore doctor`; or its UUID, which stays the same
            after a start of the system.
        report: Receives a sentence on a self-test while it runs.
        cancel: Returns whether a self-test is to stop.
        find: Lists the devices.

    Raises:
        ConfigError: there is no such device.
        BackendError: the device cannot be used, with the reason.
        Cancelled: `cancel` returned True.
    """
    if device == "cpu":
        return CPU
    if not is_device(device):
        raise ConfigError(
            f"The device must be cpu, gpu, auto or a number that `gscore doctor` lists, got "
            f"{device[:40]!r}."
        )
    if device == "auto" and (absent := no_automatic_card()):
        return Chosen(device=None, reason=absent)
    found = find()
    if device not in ("gpu", "auto"):
        return _named(device, found, report, cancel)
    real = [one for one in found.devices if not one.is_software]
    real.sort(key=lambda one: _ORDER.index(one.kind))
    best = [one for one in real if one.kind == real[0].kind]
    turn = _rank_on_this_machine() % max(len(best), 1)
    real = best[turn:] + best[:turn] + real[len(best) :]
    failures = list(found.problems)
    for one in real:
        failure = _failure(one, report, cancel)
        if not failure:
            note = f"{one.name} is used. {_why(failures, [])}" if failures else ""
            return Chosen(device=one, note=note, fallback=device == "auto")
        failures.append(f"Device {one.number} ({one.name}): {failure}")
    software = [one for one in found.devices if one.is_software]
    if device == "auto":
        why = _why(failures, software)
        # Where no card could be used before, the CPU is nothing to mention.
        return Chosen(device=None, note=f"The CPU is used. {why}" if real else "", reason=why)
    for one in software:
        if not (failure := _failure(one, report, cancel)):
            return Chosen(device=one, note=f"{_software_note(one)} {_why(failures, [])}".rstrip())
        failures.append(f"Device {one.number} ({one.name}): {failure}")
    raise BackendError(f"No graphics card can be used. {_why(failures, [])}".rstrip())


def _rank_on_this_machine() -> int:
    """Number of this process among those that torchrun started here, each of which takes another
    one of the best cards; 0: without torchrun."""
    text = os.environ.get("LOCAL_RANK", "")
    return int(text) if text.isascii() and text.isdigit() else 0


def _named(
    name: str, found: FoundDevices, report: Report | None, cancel: Callable[[], bool] | None
) -> Chosen:
    """The device with a number or UUID."""
    if _UUID.fullmatch(name):
        chosen = [one for one in found.devices if one.uuid == name]
    else:
        chosen = [one for one in found.devices if one.number == int(name)]
    if not chosen:
        raise ConfigError(_absent(name, found))
    device = chosen[0]
    if failure := _failure(device, report, cancel):
        raise BackendError(f"Device {device.number} ({device.name}) is not used. {failure}")
    return Chosen(device=device, note=_software_note(device) if device.is_software else "")


def _absent(name: str, found: FoundDevices) -> str:
    """Why there is no device with a number or UUID, as sentences."""
    what = f"There is no device {name}"
    if _UUID.fullmatch(name):
        what = "The chosen graphics card is not in this computer any more"
    if not found.devices:
        return f"{what}. {_why(list(found.problems), [])}".rstrip()
    last = len(found.devices) - 1
    there = "only device 0" if not last else f"devices 0 to {last}"
    return f"{what}; `gscore doctor` lists {there}."


def _software_note(device: Device) -> str:
    return (
        f"{device.name} is a software device: the CPU computes its pictures, more slowly than with "
        "`--device cpu`."
    )


def _failure(device: Device, report: Report | None, cancel: Callable[[], bool] | None) -> str:
    """Why a device cannot be used, as a sentence; empty: it passed its self-test."""
    return device.unusable or failure_text(verified(device, report=report, cancel=cancel))


def _why(failures: Sequence[str], software: Sequence[Device]) -> str:
    """The reason why there is no graphics card, as a sentence."""
    if failures:
        return failures[0]
    if software:
        return f"The only device, {software[0].name}, is a software device."
    return ""


def once_a_device(show: Report) -> Report:
    """Receives the sentences on self-tests and passes on the first one of each device."""
    shown: list[str] = []

    def report(sentence: str) -> None:
        if not shown or not sentence.startswith(shown[-1]):
            shown.append(sentence)
            show(sentence)

    return report


_by_name: dict[str, Chosen] = {}
"""Choices of this process by the value that named them."""


def chosen_device(device: str | Chosen) -> Chosen:
    """A choice by name, made once a process; a choice itself is returned.

    Raises:
        As `choose`.
    """
    if isinstance(device, Chosen):
        return device
    if device not in _by_name:
        found = choose(device, report=once_a_device(lambda text: _log.warning("%s.", text)))
        if found.note:
            _log.warning("%s", found.note)
        _by_name[device] = found
    return _by_name[device]


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_by_name.clear)
