"""Device that renders: the preference's choice, in a render server, so that no graphics driver runs
inside Blender; the CPU where it fails."""

import json
from typing import Any, ClassVar

import bpy

from .. import core, preferences
from ..core import Rendered, render
from ..interface.incremental_operator import IncrementalOperator
from ..interface.option_labels import error_text
from ..preferences import SECTIONS, Preferences
from ..process.incremental_tasks import Steps, run_in_thread


class RenderDevice:
    """A device that draws pictures, for any thread. Each failure costs one picture's time: the CPU
    draws it then. After two in a row the device is off."""

    def __init__(self, name: str, client: "core.RenderClient") -> None:
        """Initialise.

        Args:
            name: Subject of the sentences.
            client: What draws on it.
        """
        self._name, self._client = name, client
        self._failures = 0
        self.is_off = False
        """Whether the CPU draws from now on."""
        self.sentences: list[str] = []
        """All failures so far, and the reason if there is no device."""
        self.problem = ""
        """Why the CPU has drawn the last picture; empty: it has not."""

    @property
    def status(self) -> str:
        """A sentence on what the device does at the moment, if it takes long."""
        return self._client.status

    def render(self, *args: Any, **how: Any) -> Rendered:
        """`gscore.render` on this device, or on the CPU where that fails."""
        if self.is_off:
            if not self._failures:  # the reason is shown once
                self.problem = ""
            return render(*args, **how, device="cpu")
        try:
            drawn = render(*args, **how, device=self._client)
        except core.NoDeviceError as error:
            self.is_off = True
            self.problem = error_text(error)
            self.sentences.append(self.problem)
        except core.RenderServerError as error:
            self._fail(error_text(error))
        else:
            self._failures, self.problem = 0, ""
            return drawn
        return render(*args, **how, device="cpu")

    def close(self) -> None:
        """End the server."""
        self._client.close()

    def _fail(self, reason: str) -> None:
        self._failures += 1
        self.is_off = self._failures > 1
        rest = "The CPU draws instead."
        if self.is_off:
            rest = (
                "After two failures the CPU draws for the rest of this session; choose the device "
                "again in the preferences to try it again."
            )
        self.problem = f"{self._name} failed: {reason} {rest}"
        self.sentences.append(self.problem)


class DeviceChoice:
    """The device of the preference, which keeps its server while it is chosen."""

    def __init__(self) -> None:
        """Initialise without a device."""
        self._chosen: tuple[str, RenderDevice] | None = None

    def device(self) -> RenderDevice | None:
        """The device; None: the CPU, for which nothing is loaded or started."""
        value = preferences.get().device or preferences.AUTO
        if self._chosen is not None and self._chosen[0] != value:
            self.forget()
        if not preferences.uses_card():
            return None
        if self._chosen is None:
            client = core.RenderClient(value.lower(), folder=bpy.app.tempdir)
            self._chosen = value, RenderDevice(preferences.device_name(value), client)
        return self._chosen[1]

    def forget(self) -> None:
        """End the server."""
        if self._chosen is not None:
            self._chosen[1].close()
            self._chosen = None


CHOICE = DeviceChoice()
"""The choice of this Blender."""


class FindDevices(IncrementalOperator, bpy.types.Operator):
    """Find the graphics cards of this computer that can render splats"""

    bl_idname = "gscore.find_devices"
    bl_label = "Find Graphics Cards"
    bl_options: ClassVar = set()

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Look for them in another process, and list them in the preferences."""
        folder = bpy.app.tempdir
        found, problems = yield from run_in_thread(
            lambda _: core.find_devices(folder), "Looking for graphics cards"
        )
        usable = [one for one in found if not one["reason"]]
        names = [[one["uuid"], one["name"]] for one in usable]
        preferences.get().found_devices = json.dumps(names)
        problems += [f"{one['name']}: {one['reason']}" for one in found if one["reason"]]
        listed = ", ".join(one["name"] for one in usable)
        return " ".join([f"Found {listed}." if listed else "Found no graphics card.", *problems])


def draw_device(layout: bpy.types.UILayout, prefs: Preferences) -> None:
    """Draw the choice of the device."""
    row = layout.row(align=True)
    row.use_property_split = True
    row.prop(prefs, "device")
    row.operator("gscore.find_devices", text="", icon="FILE_REFRESH")
    if preferences.uses_card():
        column = layout.column()
        column.use_property_split = True
        column.prop(prefs, "gpu_share", slider=True)


APPENDED = ((SECTIONS, draw_device),)


def on_unregister() -> None:
    """End the server."""
    CHOICE.forget()
