"""Incremental operators: long work in short steps in a window, in one call for scripts."""

from dataclasses import dataclass, field

import bpy

from ..core import GsError
from ..process.incremental_tasks import Pieces, ResultT, TaskRunner, run_blocking
from ..process.pace import Pace
from . import editable_check
from .base_operator import BaseOperator
from .incremental_removal import finish
from .modal_status import INTERVAL, ModalStatus


class IncrementalOperator(BaseOperator):
    """Work in steps, cancelled by Esc. Scripts and the redo panel run it in one call."""

    def pieces(self, context: bpy.types.Context) -> Pieces[str]:
        """The work in steps; returns the text of the report.

        Blender's data may change between two steps, so objects are looked up again.

        Raises:
            GsError, ValueError, OSError: it cannot be done; the message is for the user.
        """
        raise NotImplementedError

    def act(self, context: bpy.types.Context) -> str:
        """Run all steps in one call."""
        try:
            return run_blocking(in_words(self.pieces(context)))
        finally:
            finish()

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Of a button: without this, Blender does not tell that a user pressed it."""
        return self.execute(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the steps in a window; for a script or a repeated operator run all at once."""
        # Blender crashes where an operator that is repeated goes on event by event.
        again = self.options.is_repeat or self.options.is_repeat_last
        called = self.options.is_invoke and not again
        if bpy.app.background or context.window is None or not called:
            return super().execute(context)
        try:
            editable_check.check(*self.changes(context))
            going = TaskRunner(in_words(self.pieces(context)))
            done = going.step()
        except (GsError, ValueError, OSError) as error:
            return self.refuse(error)
        if done:
            return self._finished(going)
        self._under_way = _UnderWay(going, ModalStatus(context, "Esc cancels"))
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Run a step at a timer event; pass other events through."""
        own = self._under_way
        if event.type == "ESC" and event.value == "PRESS":
            own.give_up()
            self.report({"INFO"}, f"{self.bl_label} is cancelled.")
            return {"CANCELLED"}
        if event.type != "TIMER" or bpy.app.is_job_running("RENDER"):
            return {"PASS_THROUGH"}
        try:
            done = own.step()
        except (GsError, ValueError, OSError) as error:
            own.give_up()
            return self.refuse(error)
        except Exception:
            own.give_up()  # or its timer would go on
            raise
        if not done:
            own.waiting.tell(own.going.sentence)
            return {"PASS_THROUGH"}
        own.end()
        return self._finished(own.going)

    def cancel(self, context: bpy.types.Context) -> None:
        """Clean up; called by Blender before a file load or its end."""
        if (own := getattr(self, "_under_way", None)) is not None:  # else it was the file browser
            own.give_up()

    def _finished(self, going: TaskRunner) -> set[str]:
        if going.result:
            self.report({"INFO"}, going.result)
        return {"FINISHED"}


@dataclass(frozen=True, eq=False)
class _UnderWay:
    """State of a running operator in a window."""

    going: TaskRunner
    waiting: ModalStatus

    pace: Pace = field(default_factory=Pace)

    def __post_init__(self) -> None:
        _UNDER_WAY.add(self)

    def step(self) -> bool:
        """Run steps within the pace; True if all is done."""
        self.pace.begin()
        while not (done := self.going.step()) and self.pace.more():
            pass
        self.pace.end(INTERVAL)
        return done

    def end(self) -> None:
        """Remove the timer and the status text."""
        _UNDER_WAY.discard(self)
        self.waiting.end()

    def give_up(self) -> None:
        """Cancel before the end."""
        try:
            self.going.cancel()
        finally:
            self.end()


_UNDER_WAY: set[_UnderWay] = set()


def in_words(pieces: Pieces[ResultT]) -> Pieces[ResultT]:
    """The same steps, with a readable error if memory runs out."""
    try:
        return (yield from pieces)
    except MemoryError as error:
        raise GsError(
            "There is not enough memory for this: close other programs, or do it to fewer splats."
        ) from error


def on_unregister() -> None:
    """Give up what is under way: Blender forgets its operators without a word to them."""
    for own in list(_UNDER_WAY):
        own.give_up()
