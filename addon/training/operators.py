"""Training operators: train, resume, pause, stop and discard a run, import and show its
result, choose guide meshes; choose one of the captures of a scene.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty

from .. import preferences, stored_paths
from ..cameras.lookup import roots_of
from ..capture.folders import means_capture
from ..interface.base_operator import (
    BaseOperator,
    Condition,
    ConfirmMixin,
    OnScene,
    Undoable,
    Waiting,
    make_active,
)
from ..interface.blocks import first_few
from ..interface.images import show_image
from ..paths import absolute, output_folder, relative
from ..process import poll_timer
from ..run_links import holders
from ..splats import splat_files, splat_framing
from ..splats.file_operators import ImportOperator
from . import facts, guides, registry, results, run_state, start_training
from .options import BY_WIDTH
from .training_job import Job


class _OnJob(BaseOperator):
    """Base of the operators on a training: that of the scene, or one given by its id."""

    job_id: StringProperty(
        name="Training",
        description="Id of the training; empty: the training of this scene",
        options={"HIDDEN", "SKIP_SAVE"},
    )
    allowed: ClassVar[tuple[str, ...]] = (run_state.STARTING, run_state.RUNNING, run_state.PAUSED)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if any(job.state.status in cls.allowed for job in registry.jobs()):
            return True
        cls.poll_message_set("No training is in a state that allows this")
        return False

    def job(self, context: bpy.types.Context) -> Job | None:
        """The training to work on."""
        return registry.by_id(self.job_id) if self.job_id else start_training.job_of(context.scene)

    def run(self, context: bpy.types.Context) -> None:
        job = self.job(context)
        if job is None or job.state.status not in self.allowed:
            raise ValueError("This scene has no training in a state that allows this.")
        self.send(job)
        poll_timer.redraw()

    def send(self, job: Job) -> None:
        raise NotImplementedError


class Train(ConfirmMixin, Waiting, OnScene, bpy.types.Operator):
    """Train splats from the capture in the background"""

    bl_idname = "gscore.train"
    bl_label = "Train"

    overwrite: BoolProperty(
        name="Start Over",
        description="Replace another run in the output folder",
        options={"SKIP_SAVE"},
    )
    confirm = "Start Over"

    def confirm_lines(self, context: bpy.types.Context) -> list[str]:
        """List overwritten files, and data that the training would not use."""
        lines = start_training.replaced(context.scene) if self.overwrite else []
        self.confirm = "Start Over" if lines else "Train Without"
        return lines + start_training.unsaved(context.scene)

    def run(self, context: bpy.types.Context) -> str:
        """Start the training."""
        self.warn(start_training.unsaved(context.scene))
        return _report(
            start_training.train(context.scene, overwrite=self.overwrite, wait=self.wait)
        )


class FitTraining(OnScene, bpy.types.Operator):
    """Reduce the number of splats, or the width of the photos, to fit into the free memory"""

    bl_idname = "gscore.fit_training"
    bl_label = "Fit into Memory"

    which: EnumProperty(
        name="Change",
        description="Setting to reduce",
        items=(
            ("SPLATS", "Splats", "Fewer splats"),
            ("WIDTH", "Photos", "Smaller photos"),
        ),
    )

    def run(self, context: bpy.types.Context) -> None:
        """Change the settings."""
        settings = context.scene.gscore
        found, problem = facts.forecast_of(context.scene)
        splats = self.which == "SPLATS"
        value = 0 if found is None else found.fitting_splats if splats else found.fitting_width
        if not value:
            raise ValueError(problem or "The training fits already, or nothing can be reduced.")
        if splats:
            settings.max_splats = value
        else:
            settings.resolution, settings.width = BY_WIDTH, value


class ResumeTraining(Waiting, OnScene, bpy.types.Operator):
    """Resume the run in the output folder from its last checkpoint"""

    bl_idname = "gscore.resume_training"
    bl_label = "Resume"

    def run(self, context: bpy.types.Context) -> str:
        """Resume the training."""
        return _report(start_training.resume(context.scene, wait=self.wait))


class PauseTraining(_OnJob, bpy.types.Operator):
    """Pause the training; it keeps its memory and frees its CPU cores"""

    bl_idname = "gscore.pause_training"
    bl_label = "Pause"
    allowed = (run_state.STARTING, run_state.RUNNING)
    send = staticmethod(Job.pause)


class ContinueTraining(_OnJob, bpy.types.Operator):
    """Continue a paused training"""

    bl_idname = "gscore.continue_training"
    bl_label = "Continue"
    allowed = (run_state.PAUSED,)
    send = staticmethod(Job.unpause)


class StopTraining(_OnJob, bpy.types.Operator):
    """Write a checkpoint and the current splats, and end; Resume continues from there"""

    bl_idname = "gscore.stop_training"
    bl_label = "Stop"
    send = staticmethod(Job.stop)


class FollowTraining(OnScene, bpy.types.Operator):
    """Choose the capture and output folder of this training, to show its splats here"""

    bl_idname = "gscore.follow_training"
    bl_label = "Follow Training"

    job_id: StringProperty(name="Training", description="Id of the training", options={"HIDDEN"})

    def run(self, context: bpy.types.Context) -> str:
        """Choose the training's capture and output folder."""
        job = registry.by_id(self.job_id)
        if job is None:
            raise ValueError("This training was removed; press Show Trained Splats under Train.")
        start_training.follow(context.scene, job)
        return f"This scene shows the training of {job.source.name}."


class DiscardTraining(ConfirmMixin, _OnJob, bpy.types.Operator):
    """End the training immediately and remove its files; a resumed run keeps its last checkpoint"""

    bl_idname = "gscore.discard_training"
    bl_label = "Discard"
    allowed = (run_state.STARTING, run_state.RUNNING, run_state.PAUSED, run_state.STOPPING)

    confirm = "Discard"

    def confirm_lines(self, context: bpy.types.Context) -> list[str]:
        """Name the run, because it cannot be restored."""
        job = self.job(context)
        if job is None:
            return []
        what = "since its last checkpoint" if job.resumed else "with its files and splats"
        return [f"The training of {job.source} into {job.output} ends and is lost, {what}."]

    send = staticmethod(start_training.discard)


class UpdateSplats(_OnJob, bpy.types.Operator):
    """Show the current splats of the training in the viewport"""

    bl_idname = "gscore.update_splats"
    bl_label = "Update Splats"
    allowed = (run_state.RUNNING, run_state.PAUSED)
    send = staticmethod(Job.snapshot)


class ShowTestView(BaseOperator, bpy.types.Operator):
    """Show the picture of the test view in an image editor, in a new window if there is none"""

    bl_idname = "gscore.show_test_view"
    bl_label = "Show Test View"
    needs = Condition(lambda context: context.scene.gscore.preview is not None)

    def run(self, context: bpy.types.Context) -> None:
        """Show the picture."""
        if not show_image(context, context.scene.gscore.preview, new_window=True):
            raise ValueError("There is no window to show a picture in.")


class SelectResult(Undoable, bpy.types.Operator):
    """Make the splats of the training the active object"""

    bl_idname = "gscore.select_result"
    bl_label = "Select Result"

    def run(self, context: bpy.types.Context) -> None:
        """Select."""
        ob = context.scene.gscore.result
        if ob is None or context.view_layer.objects.get(ob.name) is None:
            raise ValueError("This scene has no trained splats; press Train first.")
        make_active(context, ob)


class ShowReport(BaseOperator, bpy.types.Operator):
    """Open the report of the training in the web browser: curves, pictures, numbers"""

    bl_idname = "gscore.show_report"
    bl_label = "Show Report"

    def run(self, context: bpy.types.Context) -> None:
        """Open the report."""
        report = output_folder(context.scene, preferences.get().output_folder) / "report.html"
        if not report.is_file():
            raise ValueError(f"There is no {report}; the report is written when a training ends.")
        bpy.ops.wm.url_open(url=report.as_uri())


def _report(job: Job) -> str:
    """Message on the end of an awaited training; empty while it is running.

    Raises:
        ValueError: it failed.
    """
    if job.state.status == run_state.FAILED:
        raise ValueError(job.state.sentence)
    return job.state.sentence if job.state.ended else ""


class AddGuides(OnScene, bpy.types.Operator):
    """Add the selected objects to the collection of meshes that guide the training"""

    bl_idname = "gscore.add_guides"
    bl_label = "Add Selected"
    needs = Condition(lambda context: bool(context.selected_objects), "Select the meshes first")

    role: EnumProperty(
        name="Role",
        description="Use of the meshes in the training",
        items=(
            ("surface", "Surface Mesh", "Splats are pulled onto these meshes"),
            ("free", "Free-Space Mesh", "Splats between the cameras and these meshes are removed"),
        ),
    )

    def run(self, context: bpy.types.Context) -> str:
        """Link the objects."""
        obs = [ob for ob in context.selected_objects if guides.may_guide(ob)]
        if not obs:
            raise ValueError("None of the selected objects is a mesh or can be converted to one.")
        collection = guides.add_to_guides(context.scene, self.role, obs)
        return f"Added {first_few([ob.name for ob in obs])} to {collection.name}."


class ImportResult(ImportOperator, bpy.types.Operator):
    """Import the splats of the run in the output folder, aligned with the capture"""

    bl_idname = "gscore.import_result"
    bl_label = "Show Trained Splats"

    def import_requests(self, context: bpy.types.Context) -> list[splat_files.ImportRequest]:
        """The splats of the run."""
        # Read now, because the panel may name another run during the import.
        self._source, self._run = start_training.run_of(context.scene)
        info = self._run.info
        if info.splats is None:
            raise ValueError(f"{info.path} contains no splats yet: continue its training.")
        return [
            splat_files.import_request(
                info.splats, parent=results.capture_of(context.scene, self._source)
            )
        ]

    def show(
        self, context: bpy.types.Context, made: list[bpy.types.Object], warnings: list[str]
    ) -> str:
        """Make the object the result of the training."""
        self.warn(warnings)
        ob = results.adopt(context.scene, made[0], self._run, self._source)
        if context.mode == "OBJECT" and ob.name in context.view_layer.objects:
            make_active(context, ob)
            context.view_layer.update()
            splat_framing.turn_views(context.scene, ob)
            self.warn(splat_framing.set_camera(context.scene, ob, may_add=False))
        return f"{ob.name} has the {len(ob.data.vertices):,} splats of {self._run.info.path}."


def known(scene: bpy.types.Scene) -> list[Path]:
    """Folders of the captures that a scene has chosen or imported, unique and sorted by name."""
    unique: list[Path] = []
    # Parent folders first.
    for path in sorted(_all(scene), key=lambda path: len(path.parts)):
        if not any(means_capture(path, other) for other in unique):
            unique.append(path)
    return sorted(unique, key=lambda path: (path.name.lower(), str(path)))


def label(path: Path, among: list[Path]) -> str:
    """Label of a capture: its folder's name, with the parent folder if another has that name."""
    namesakes = [other for other in among if other.name == path.name]
    return path.name if len(namesakes) < 2 else f"{path.name} ({path.parent})"


def _all(scene: bpy.types.Scene) -> Iterator[Path]:
    for holder in holders(scene):
        if holder.capture_path.strip():
            try:
                yield absolute(holder.capture_path, "Capture")
            except ValueError:
                continue  # relative to an unsaved file
    for root in roots_of(scene):
        if text := stored_paths.read(root, stored_paths.SOURCE):
            yield Path(text)


class ChooseCapture(OnScene, bpy.types.Operator):
    """Choose a capture of this scene, with its output, splats and test view"""

    bl_idname = "gscore.choose_capture"
    bl_label = "Choose Capture"

    path: StringProperty(name="Capture", description="Folder of the capture", options={"SKIP_SAVE"})

    def run(self, context: bpy.types.Context) -> None:
        """Choose the capture."""
        if not self.path.strip():
            raise ValueError("No capture is given; choose one in the panel.")
        context.scene.gscore.capture_path = relative(absolute(self.path, "Capture"))
