"""What operators share that bring files of splats: bit by bit in a window, at once for scripts."""

from typing import Protocol

import bpy

from ..core import GsError, collected_warnings
from ..interface import writable
from ..interface.operators import OnScene
from ..interface.waiting import Waiting
from . import files
from .arrival import Arrival


class Coming(Protocol):
    """Objects on their way."""

    warnings: list[str]
    """What the user should know besides."""

    @property
    def sentence(self) -> str:
        """How far it is."""

    def step(self) -> list[bpy.types.Object] | None:
        """Do a small piece; the objects once all are there. ValueError: nothing of it is left."""

    def cancel(self) -> None:
        """Leave nothing."""


class Arriving(OnScene):
    """They say which files, and what becomes of the objects."""

    def wanted(self, context: bpy.types.Context) -> list[files.Wanted]:
        """Which files; ValueError where there is nothing to bring."""
        raise NotImplementedError

    def begin(self, context: bpy.types.Context) -> Coming:
        """What comes bit by bit: the files, unless an operator says otherwise."""
        return Arrival(context, self.wanted(context))

    def show(
        self, context: bpy.types.Context, made: list[bpy.types.Object], warnings: list[str]
    ) -> str:
        """Take care of the objects, one a file; what to tell the user."""
        raise NotImplementedError

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Import: for a user in a window bit by bit, for a script or once more at once."""
        called = self.options.is_invoke and not self.options.is_repeat
        if bpy.app.background or context.window is None or not called:
            return super().execute(context)
        try:
            writable.check(*self.changes(context))
            self._arrival = self.begin(context)
        except (ValueError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self._waiting = Waiting(context, "Esc cancels")
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Go on with it; whatever else is pressed is for others."""
        if event.type == "ESC" and event.value == "PRESS":
            self.cancel(context)
            self.report({"INFO"}, f"{self.bl_label} is cancelled.")
            return {"CANCELLED"}
        if event.type != "TIMER" or bpy.app.is_job_running("RENDER"):
            return {"PASS_THROUGH"}
        try:
            made = self._arrival.step()
            if made is None:
                self._waiting.tell(self._arrival.sentence)
                return {"PASS_THROUGH"}
            told = self.show(context, made, self._arrival.warnings)
        except ValueError as error:
            self.cancel(context)
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self._waiting.end()
        self.report({"INFO"}, told)
        return {"FINISHED"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender calls this where another file is opened, or it ends: leave nothing."""
        if (arrival := getattr(self, "_arrival", None)) is not None:  # else it was the file browser
            arrival.cancel()
            self._waiting.end()

    def act(self, context: bpy.types.Context) -> str:
        """Import one or several files; none of them where one cannot be read."""
        made: list[bpy.types.Object] = []
        try:
            with collected_warnings() as warnings:
                for wanted in self.wanted(context):
                    made.append(files.import_wanted(context, wanted))
        except (GsError, ValueError, OSError):
            for ob in made:
                bpy.data.meshes.remove(ob.data)
            raise
        return self.show(context, made, warnings)
