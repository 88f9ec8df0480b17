"""Operators that take long: bit by bit where a user waits in a window, at once for scripts."""

import bpy

from ..core import GsError
from ..process.pieces import Going, Pieces, at_once
from . import writable
from .operators import Acting
from .waiting import Waiting


class Stepping(Acting):
    """They say what is done in pieces; Esc cancels. Scripts, and the redo panel, wait for it."""

    def pieces(self, context: bpy.types.Context) -> Pieces[str]:
        """Do it; returns what to tell the user.

        Between two pieces anything may happen in Blender: objects are looked up anew.

        Raises:
            GsError, ValueError, OSError: it cannot be done; the message is for the user.
        """
        raise NotImplementedError

    def act(self, context: bpy.types.Context) -> str:
        """Do it at once."""
        return at_once(_in_words(self.pieces(context)))

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Of a button: without this, Blender does not tell that a user pressed it."""
        return self.execute(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """For a user in a window bit by bit, for a script or once more at once."""
        called = self.options.is_invoke and not self.options.is_repeat
        if bpy.app.background or context.window is None or not called:
            return super().execute(context)
        try:
            writable.check(*self.changes(context))
            self._going = Going(_in_words(self.pieces(context)))
            done = self._going.step()
        except (GsError, ValueError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if done:
            return self._finished()
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
            done = self._going.step()
        except (GsError, ValueError, OSError) as error:
            self.cancel(context)
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        except Exception:
            self.cancel(context)  # or its timer would go on
            raise
        if not done:
            self._waiting.tell(self._going.sentence)
            return {"PASS_THROUGH"}
        self._waiting.end()
        return self._finished()

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender calls this where another file is opened, or it ends: leave nothing."""
        if (going := getattr(self, "_going", None)) is not None:  # else it was the file browser
            going.cancel()
            self._waiting.end()

    def _finished(self) -> set[str]:
        if self._going.result:
            self.report({"INFO"}, self._going.result)
        return {"FINISHED"}


def _in_words(pieces: Pieces[str]) -> Pieces[str]:
    """The same, with a sentence where memory is lacking."""
    try:
        return (yield from pieces)
    except MemoryError as error:
        raise GsError(
            "There is not enough memory for this: close other programs, or do it to fewer splats."
        ) from error
