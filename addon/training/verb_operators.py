"""Verb operators: shared bases of the operators that run gscore commands in the background."""

from typing import ClassVar

import bpy
from bpy.props import BoolProperty

from ..interface.base_operator import BaseOperator
from ..process import poll_timer
from .verb_job import FAILED, VerbJob


class Waiting(BaseOperator):
    """Mixin before bpy.types.Operator that starts work in the background."""

    bl_options: ClassVar = {"REGISTER"}

    wait: BoolProperty(
        name="Wait",
        description="Return when the work has ended and its result is imported; for scripts",
        options={"HIDDEN", "SKIP_SAVE"},
    )


class Starting(Waiting):
    """Mixin before bpy.types.Operator that starts a job."""

    def run(self, context: bpy.types.Context) -> str:
        """Start the job."""
        return ended(self.start(context))

    def start(self, context: bpy.types.Context) -> VerbJob:
        """Start the job; errors as `run`."""
        raise NotImplementedError


class Cancelling(BaseOperator):
    """Mixin before bpy.types.Operator that cancels the scene's job of a verb."""

    none = ""
    """Message if there is nothing to cancel."""

    def run(self, context: bpy.types.Context) -> None:
        """Cancel the job."""
        job = self.job_of(context.scene)
        if job is None or job.ended:
            raise ValueError(self.none)
        job.cancel()
        poll_timer.redraw()

    def job_of(self, scene: bpy.types.Scene) -> VerbJob | None:
        """The scene's job."""
        raise NotImplementedError


def ended(job: VerbJob) -> str:
    """Message on the end of a job; empty while it is running.

    Raises:
        ValueError: it failed.
    """
    if job.status == FAILED:
        raise ValueError(job.sentence)
    return job.sentence
