"""Verb operators: shared base of the operators that run gscore commands in the background."""

import bpy

from ..interface.base_operator import BaseOperator
from ..process import poll_timer
from .verb_job import VerbJob


class Cancelling(BaseOperator):
    """Mixin before bpy.types.Operator that cancels the scene's job of a verb."""

    none = ""
    """Message if there is nothing to cancel."""

    def act(self, context: bpy.types.Context) -> str:
        """Cancel the job."""
        job = self.job_of(context.scene)
        if job is None or job.ended:
            raise ValueError(self.none)
        job.cancel()
        poll_timer.redraw()
        return ""

    def job_of(self, scene: bpy.types.Scene) -> VerbJob | None:
        """The scene's job."""
        raise NotImplementedError
