"""Operators of the training and of its Python."""

from pathlib import Path
from typing import ClassVar

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty

from .. import preferences
from ..interface.questions import Asking
from ..process import beat
from ..python import setup
from ..render.operators import show_image
from . import facts, registry, session, training
from .job import Job
from .options import BY_WIDTH

Result = set[str]


class _JobOperator:
    """What operators on a training share: the scene's own, or one named by its id."""

    job_id: StringProperty(
        name="Training",
        description="Which training; empty: the one of this scene",
        options={"HIDDEN", "SKIP_SAVE"},
    )
    allowed: ClassVar[tuple[str, ...]] = (session.STARTING, session.RUNNING, session.PAUSED)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if any(job.state.status in cls.allowed for job in registry.jobs()):
            return True
        cls.poll_message_set("No training is in the state for this")
        return False

    def job(self, context: bpy.types.Context) -> Job | None:
        """The training that is meant."""
        return registry.by_id(self.job_id) if self.job_id else training.job_of(context.scene)

    def execute(self, context: bpy.types.Context) -> Result:
        job = self.job(context)
        if job is None or job.state.status not in self.allowed:
            self.report({"ERROR"}, "This scene has no training in the state for this.")
            return {"CANCELLED"}
        self.act(job)
        beat.redraw()
        return {"FINISHED"}

    def act(self, job: Job) -> None:
        raise NotImplementedError


class Train(Asking, bpy.types.Operator):
    """Train splats from the capture in the background; Blender stays free"""

    bl_idname = "gscore.train"
    bl_label = "Train"
    bl_options: ClassVar = {"REGISTER"}

    overwrite: BoolProperty(
        name="Start Over",
        description="Replace another run in the output folder",
        options={"SKIP_SAVE"},
    )
    wait: BoolProperty(
        name="Wait",
        description="Return when the training has ended; for scripts",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    confirm = "Start Over"

    def question(self, context: bpy.types.Context) -> list[str]:
        """Name what an earlier run loses."""
        return training.replaced(context.scene) if self.overwrite else []

    def execute(self, context: bpy.types.Context) -> Result:
        """Start."""
        try:
            job = training.train(context.scene, overwrite=self.overwrite, wait=self.wait)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return _told(self, job)


class FitTraining(bpy.types.Operator):
    """Take the number of splats, or the width of the photos, that fits into the free memory"""

    bl_idname = "gscore.fit_training"
    bl_label = "Fit into Memory"
    bl_options: ClassVar = {"REGISTER", "UNDO"}

    which: EnumProperty(
        name="Change",
        description="What to make smaller",
        items=(
            ("SPLATS", "Splats", "Fewer splats"),
            ("WIDTH", "Photos", "Smaller photos"),
        ),
    )

    def execute(self, context: bpy.types.Context) -> Result:
        """Change the settings."""
        settings = context.scene.gscore
        found, problem = facts.forecast_of(context.scene)
        splats = self.which == "SPLATS"
        value = 0 if found is None else found.fitting_splats if splats else found.fitting_width
        if not value:
            self.report({"ERROR"}, problem or "There is nothing to make smaller; see the panel.")
            return {"CANCELLED"}
        if splats:
            settings.max_splats = value
        else:
            settings.resolution, settings.width = BY_WIDTH, value
        return {"FINISHED"}


class ResumeTraining(bpy.types.Operator):
    """Go on with the run in the output folder from its last checkpoint"""

    bl_idname = "gscore.resume_training"
    bl_label = "Resume"
    bl_options: ClassVar = {"REGISTER"}

    wait: BoolProperty(
        name="Wait",
        description="Return when the training has ended; for scripts",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    def execute(self, context: bpy.types.Context) -> Result:
        """Start."""
        try:
            job = training.resume(context.scene, wait=self.wait)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return _told(self, job)


class PauseTraining(_JobOperator, bpy.types.Operator):
    """Let the trainer wait: it keeps its memory, and Blender gets all cores"""

    bl_idname = "gscore.pause_training"
    bl_label = "Pause"
    allowed = (session.STARTING, session.RUNNING)

    def act(self, job: Job) -> None:
        """Ask."""
        job.pause()


class ContinueTraining(_JobOperator, bpy.types.Operator):
    """Let a waiting trainer go on"""

    bl_idname = "gscore.continue_training"
    bl_label = "Continue"
    allowed = (session.PAUSED,)

    def act(self, job: Job) -> None:
        """Ask."""
        job.unpause()


class StopTraining(_JobOperator, bpy.types.Operator):
    """Write a checkpoint and the splats as they are, and end; Resume goes on from there"""

    bl_idname = "gscore.stop_training"
    bl_label = "Stop"

    def act(self, job: Job) -> None:
        """Ask."""
        job.stop()


class DiscardTraining(Asking, _JobOperator, bpy.types.Operator):
    """End at once and remove what this run wrote; a resumed run keeps its last checkpoint"""

    bl_idname = "gscore.discard_training"
    bl_label = "Discard"
    allowed = (session.STARTING, session.RUNNING, session.PAUSED, session.STOPPING)

    confirm = "Discard"

    def question(self, context: bpy.types.Context) -> list[str]:
        """Name the run, because nothing brings it back."""
        job = self.job(context)
        if job is None:
            return []
        what = "since its last checkpoint" if job.resumed else "with its files and splats"
        return [f"The training of {job.source} into {job.output} ends and is lost, {what}."]

    def act(self, job: Job) -> None:
        """End it."""
        training.discard(job)


class UpdateSplats(_JobOperator, bpy.types.Operator):
    """Show the splats as they are now in the viewport"""

    bl_idname = "gscore.update_splats"
    bl_label = "Update Splats"
    allowed = (session.RUNNING, session.PAUSED)

    def act(self, job: Job) -> None:
        """Ask for them."""
        job.snapshot()


class ShowTestView(bpy.types.Operator):
    """Show the picture of the test view in an image editor, in a new window if there is none"""

    bl_idname = "gscore.show_test_view"
    bl_label = "Show Test View"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There is a picture."""
        return context.scene.gscore.preview is not None

    def execute(self, context: bpy.types.Context) -> Result:
        """Show it."""
        if not show_image(context, context.scene.gscore.preview, new_window=True):
            self.report({"ERROR"}, "There is no window to show a picture in.")
            return {"CANCELLED"}
        return {"FINISHED"}


class SelectResult(bpy.types.Operator):
    """Make the splats of the training the active object"""

    bl_idname = "gscore.select_result"
    bl_label = "Select Result"
    bl_options: ClassVar = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> Result:
        """Select."""
        ob = context.scene.gscore.result
        if ob is None or context.view_layer.objects.get(ob.name) is None:
            self.report({"ERROR"}, "This scene shows no splats of a training; train some first.")
            return {"CANCELLED"}
        for other in context.selected_objects:
            other.select_set(False)
        ob.select_set(True)
        context.view_layer.objects.active = ob
        return {"FINISHED"}


class ShowReport(bpy.types.Operator):
    """Open the report of the training in the web browser: curves, pictures, numbers"""

    bl_idname = "gscore.show_report"
    bl_label = "Show Report"

    def execute(self, context: bpy.types.Context) -> Result:
        """Open it."""
        try:
            report = training.report_of(context.scene)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        bpy.ops.wm.url_open(url=report.as_uri())
        return {"FINISHED"}


class CheckTrainer(bpy.types.Operator):
    """Ask the chosen Python whether it can train; without one, look for one that can"""

    bl_idname = "gscore.check_trainer"
    bl_label = "Check"

    wait: BoolProperty(
        name="Wait",
        description="Return when the answer is there; for scripts",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    def execute(self, context: bpy.types.Context) -> Result:
        """Ask."""
        prefs = preferences.get()
        if not self.wait:
            setup.start_check(prefs)
            beat.ensure()
            return {"FINISHED"}
        verdict = setup.check(prefs)
        self.report({"INFO" if verdict.good else "ERROR"}, verdict.sentence)
        return {"FINISHED" if verdict.good else "CANCELLED"}


class MakeEnvironment(Asking, bpy.types.Operator):
    """Make a private Python environment for training: downloads torch and its company"""

    bl_idname = "gscore.make_environment"
    bl_label = "Make Environment"

    wheel: StringProperty(
        name="Wheel",
        description="gscore to install; empty: the one in the extension",
        options={"HIDDEN", "SKIP_SAVE"},
    )
    wait: BoolProperty(
        name="Wait",
        description="Return when it is made; for scripts",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    confirm = "Download and Install"

    def question(self, context: bpy.types.Context) -> list[str]:
        """Name what will be installed."""
        wheel = Path(self.wheel) if self.wheel else None
        return setup.contents(preferences.get(), wheel=wheel)

    def execute(self, context: bpy.types.Context) -> Result:
        """Start."""
        wheel = Path(self.wheel) if self.wheel else None
        try:
            if self.wait:
                setup.make(preferences.get(), wheel=wheel)
            else:
                setup.start_make(preferences.get(), wheel=wheel)
        except (ValueError, RuntimeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        beat.ensure()
        return {"FINISHED"}


class CancelSetup(bpy.types.Operator):
    """End the check, or the making of an environment; one that was there before stays"""

    bl_idname = "gscore.cancel_setup"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Something is under way."""
        return setup.busy()

    def execute(self, context: bpy.types.Context) -> Result:
        """End it."""
        setup.cancel()
        return {"FINISHED"}


def _told(operator: bpy.types.Operator, job: Job) -> Result:
    """Report how a training that was waited for has ended."""
    if job.state.ended:
        failed = job.state.status == session.FAILED
        operator.report({"ERROR" if failed else "INFO"}, job.state.sentence)
        return {"CANCELLED" if failed else "FINISHED"}
    return {"FINISHED"}


CLASSES = (
    Train,
    FitTraining,
    ResumeTraining,
    PauseTraining,
    ContinueTraining,
    StopTraining,
    DiscardTraining,
    UpdateSplats,
    ShowTestView,
    SelectResult,
    ShowReport,
    CheckTrainer,
    MakeEnvironment,
    CancelSetup,
)


def register() -> None:
    """Register the operators, and follow trainings."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    beat.register()


def unregister() -> None:
    """Take them back; trainings write a checkpoint and end."""
    beat.unregister()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
