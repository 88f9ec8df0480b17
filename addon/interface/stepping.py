"""Operators that take long: bit by bit where a user waits in a window, at once for scripts."""

from typing import Any, Protocol

import bpy

from ..core import GsError
from . import writable
from .operators import Acting
from .waiting import Waiting


class Steps(Protocol):
    """What is under way."""

    @property
    def sentence(self) -> str:
        """How far it is."""

    def step(self) -> Any:
        """Do a small piece; what came of it once all is done, until then None.

        Raises:
            GsError, ValueError, OSError: it cannot be done; the message is for the user.
        """

    def cancel(self) -> None:
        """Leave nothing."""


class Stepping(Acting):
    """They say what is done bit by bit, besides what is done at once; Esc cancels."""

    def begin(self, context: bpy.types.Context) -> Steps:
        """Begin; GsError, ValueError or OSError where it cannot be done."""
        raise NotImplementedError

    def complete(self, context: bpy.types.Context, steps: Any, result: Any) -> str:
        """Take care of what came of it; what to tell the user."""
        raise NotImplementedError

    def execute(self, context: bpy.types.Context) -> set[str]:
        """For a user in a window bit by bit, for a script or once more at once."""
        called = self.options.is_invoke and not self.options.is_repeat
        if bpy.app.background or context.window is None or not called:
            return super().execute(context)
        try:
            writable.check(*self.changes(context))
            self._steps = self.begin(context)
        except (GsError, ValueError, OSError) as error:
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
            result = self._steps.step()
            if result is None:
                self._waiting.tell(self._steps.sentence)
                return {"PASS_THROUGH"}
            told = self.complete(context, self._steps, result)
        except (GsError, ValueError, OSError) as error:
            self.cancel(context)
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        except Exception:
            self.cancel(context)  # or its timer would go on
            raise
        self._waiting.end()
        self.report({"INFO"}, told)
        return {"FINISHED"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender calls this where another file is opened, or it ends: leave nothing."""
        if (steps := getattr(self, "_steps", None)) is not None:  # else it was the file browser
            steps.cancel()
            self._waiting.end()
