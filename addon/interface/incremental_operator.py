"""Incremental operators: long work in short steps, or in one call for scripts, and their status
text.
"""

import time
from dataclasses import dataclass, field

import bpy

from ..core import GsError
from ..process.incremental_tasks import Pace, ResultT, Steps, TaskRunner, run_blocking
from . import editable_check
from .base_operator import Undoable
from .incremental_removal import finish

INTERVAL = 0.01
"""Seconds between two steps."""
REDRAW = 0.25
"""Interval of changes of the status bar, seconds."""


class StatusBar:
    """Status bar of a workspace, which may be deleted meanwhile."""

    def __init__(self, workspace: bpy.types.WorkSpace) -> None:
        """Initialise without a text."""
        self._uid = workspace.session_uid

    def show(self, text: str | None) -> None:
        """Show a text; None: Blender's default."""
        for workspace in bpy.data.workspaces:
            if workspace.session_uid == self._uid:
                workspace.status_text_set(text)


class ModalStatus:
    """Timer and status text of an operator, from its start to its end."""

    def __init__(self, context: bpy.types.Context, hint: str) -> None:
        """Start a timer in the window.

        Args:
            context: The operator's context.
            hint: Key hints after each sentence.
        """
        self._hint = hint
        self._status = StatusBar(context.workspace)
        self._timer = context.window_manager.event_timer_add(INTERVAL, window=context.window)
        self._sentence, self._when = "", 0.0

    def show(self, sentence: str) -> None:
        """Show a sentence in the status bar, at a readable rate."""
        now = time.monotonic()
        if sentence != self._sentence and now - self._when > REDRAW:
            self._sentence, self._when = sentence, now
            self._status.show(f"{sentence}   |   {self._hint}")

    def end(self) -> None:
        """Remove timer and text."""
        bpy.context.window_manager.event_timer_remove(self._timer)
        self._status.show(None)


class IncrementalOperator(Undoable):
    """Work in steps, cancelled by Esc. Scripts and the redo panel run it in one call."""

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """The work in steps; returns the text of the report.

        Blender's data may change between two steps, so objects are looked up again.

        Raises:
            GsError, ValueError, OSError: the operator fails; the message is for the user.
        """
        raise NotImplementedError

    def run(self, context: bpy.types.Context) -> str:
        """Run all steps in one call."""
        try:
            return run_blocking(with_readable_errors(self.steps(context)))
        finally:
            finish()

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Called by a button; without it Blender does not set `options.is_invoke`."""
        return self.execute(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the steps in a window; scripts and repeated operators run all in one call."""
        # Blender crashes if a repeated operator becomes modal.
        again = self.options.is_repeat or self.options.is_repeat_last
        called = self.options.is_invoke and not again
        if bpy.app.background or context.window is None or not called:
            return super().execute(context)
        try:
            editable_check.check(*self.changes(context))
            runner = TaskRunner(with_readable_errors(self.steps(context)))
            done = runner.step()
        except (GsError, ValueError, OSError) as error:
            return self.refuse(error)
        if done:
            return self._finished(runner)
        self._modal_run = _ModalRun(runner, ModalStatus(context, "Esc cancels"))
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Run a step at a timer event; pass other events through."""
        own = self._modal_run
        if event.type == "ESC" and event.value == "PRESS":
            own.cancel()
            self.report({"INFO"}, f"{self.bl_label} was cancelled.")
            return {"CANCELLED"}
        if event.type != "TIMER" or bpy.app.is_job_running("RENDER"):
            return {"PASS_THROUGH"}
        try:
            done = own.step()
        except (GsError, ValueError, OSError) as error:
            own.cancel()
            return self.refuse(error)
        except Exception:
            own.cancel()  # else its timer would keep running
            raise
        if not done:
            own.status.show(own.runner.sentence)
            return {"PASS_THROUGH"}
        own.end()
        return self._finished(own.runner)

    def cancel(self, context: bpy.types.Context) -> None:
        """Clean up; called by Blender before a file load or its end."""
        if (own := getattr(self, "_modal_run", None)) is not None:  # None: from the file browser
            own.cancel()

    def _finished(self, runner: TaskRunner) -> set[str]:
        if runner.result:
            self.report({"INFO"}, runner.result)
        return {"FINISHED"}


@dataclass(frozen=True, eq=False)
class _ModalRun:
    """State of a running operator in a window."""

    runner: TaskRunner
    status: ModalStatus

    pace: Pace = field(default_factory=Pace)

    def __post_init__(self) -> None:
        _MODAL_RUNS.add(self)

    def step(self) -> bool:
        """Run steps within the pace; True if all is done."""
        self.pace.begin()
        while not (done := self.runner.step()) and self.pace.more():
            pass
        self.pace.end(INTERVAL)
        return done

    def end(self) -> None:
        """Remove the timer and the status text."""
        _MODAL_RUNS.discard(self)
        self.status.end()

    def cancel(self) -> None:
        """Cancel before the end."""
        try:
            self.runner.cancel()
        finally:
            self.end()


_MODAL_RUNS: set[_ModalRun] = set()


def with_readable_errors(steps: Steps[ResultT]) -> Steps[ResultT]:
    """The same steps, with a readable error if memory runs out."""
    try:
        return (yield from steps)
    except MemoryError as error:
        raise GsError(
            "There is not enough memory for this: close other programs, or use fewer splats."
        ) from error


def on_unregister() -> None:
    """Cancel running operators, because Blender drops them without calling `cancel`."""
    for own in list(_MODAL_RUNS):
        own.cancel()
