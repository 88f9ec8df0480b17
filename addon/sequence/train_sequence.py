"""Train a sequence: start, resume, existing results; functions for scripts, operators, settings."""

from pathlib import Path

import bpy
from bpy.props import BoolProperty

from .. import preferences
from ..core import (
    GUIDES,
    DataConfig,
    Progress,
    SequenceDone,
    SequenceFrame,
    SequenceOptions,
    choose_frames,
    find_frames,
    headline_psnr,
)
from ..interface.base_operator import ConfirmMixin
from ..interface.option_labels import error_text
from ..paths import absolute, output_folder
from ..training import facts, lookups, options, start_training
from ..training.guides import unused_objects
from ..training.properties import declared
from ..training.verb_job import Verb, VerbJob
from ..training.verb_jobs import JOBS, Cancelling, Starting
from . import guide_meshes

_FINISHED = "finished"
"""Reason of a sequence that was completed."""
ONLY_WITHIN = "Limit to Object ({}) is only for single trainings, not for sequences."


def _message(job: VerbJob) -> str:
    """A sentence with the number of complete frames."""
    done, psnr = job.done, headline_psnr(job.done.metrics)
    quality = "" if psnr is None else f", mean PSNR {psnr:.2f} dB"
    ended = "" if done.reason == _FINISHED else f" It ended early: {done.reason}."
    return f"{done.frames:,} frames are complete{quality}.{ended}"


VERB = Verb(
    running="The frames of {} are being trained already.",
    kept="Stopped; complete frames are kept, and Resume continues from there.",
    less="choose fewer splats or smaller photos, then press Resume",
    progress=(Progress,),
    done=SequenceDone,
    message=_message,
    complete=(_FINISHED,),
    expires=(lookups.sequences,),
)
"""`gscore sequence`."""


def train_sequence(
    scene: bpy.types.Scene,
    *,
    resume: bool = False,
    overwrite: bool = False,
    wait: bool = False,
) -> VerbJob:
    """Train the frames of the scene's capture, one after the other.

    Args:
        scene: Its settings are used.
        resume: Resume the sequence in the output folder.
        overwrite: Replace it.
        wait: Return when the job has ended.

    Raises:
        GsError, ValueError: something is missing or in the way; the message says what to do.
    """
    source, output = source_of(scene), output_of(scene)
    JOBS.check_free(VERB, source)
    if is_started(output) and not (resume or overwrite):
        raise ValueError(
            f"{output} has a sequence; press Resume to continue it, or Start Over to replace it."
        )
    own, machine = scene.gscore_train_sequence, start_training.machine()
    if resume:
        line = options.resumed_sequence(own, output=output, machine=machine)
        guide_options, replace_guides = [], lambda: None
    else:
        line = options.new_sequence(
            scene.gscore, own, source=source, output=output, machine=machine, overwrite=overwrite
        )
        guide_options, replace_guides = guide_meshes.arguments(
            scene, lambda: chosen_frames(scene), output
        )
    line += guide_options
    known = {"source": source, "output": output, "begun": replace_guides}
    return JOBS.start(VERB, line, **known, wait=wait)


def job_of(scene: bpy.types.Scene) -> VerbJob | None:
    """The last training of the scene's sequence, running or ended."""
    try:
        return JOBS.of_source(VERB, source_of(scene))
    except ValueError:
        return None


def source_of(scene: bpy.types.Scene) -> Path:
    """The scene's capture; its path may contain `{frame:06d}`.

    Raises:
        ValueError: none is chosen, or it does not exist.
    """
    source = absolute(scene.gscore.capture_path, "Capture")
    if "{" not in str(source) and not source.is_dir():
        raise ValueError(f"There is no folder {source}; choose the folder of the frames.")
    return source


def output_of(scene: bpy.types.Scene) -> Path:
    """The folder of the frames' results, next to the output folder of a training.

    Raises:
        ValueError: it cannot be derived from the settings.
    """
    folder = output_folder(scene, preferences.get().output_folder)
    return folder.with_name(f"{folder.name}_sequence")


def is_started(output: Path) -> bool:
    """Whether a folder has files of a sequence other than guide meshes."""
    return output.is_dir() and any(path.name != GUIDES for path in output.iterdir())


def chosen_frames(scene: bpy.types.Scene) -> list[SequenceFrame]:
    """The frames to train, read from the disk now.

    Raises:
        GsError, ValueError: there are none, or the choice of frames is invalid.
    """
    found = find_frames(DataConfig(source=source_of(scene), images=scene.gscore.images))
    return choose_frames(found, scene.gscore_train_sequence.frames.strip() or ":")


def unsupported_parts(scene: bpy.types.Scene) -> list[str]:
    """Sentences on parts of the scene that the training of a sequence would not use."""
    within = scene.gscore.train_within
    lines = [] if within is None else [ONLY_WITHIN.format(within.name)]
    return lines + unused_objects(scene)


def frames_of(scene: bpy.types.Scene) -> tuple[list[SequenceFrame] | None, str]:
    """The cached frames of the scene's capture, or the reason why there are none."""
    try:
        source = source_of(scene)
    except ValueError as error:
        return None, error_text(error)
    return facts.ask(lookups.frames, (str(source), scene.gscore.images))


class TrainSequence(ConfirmMixin, Starting, bpy.types.Operator):
    """Train the frames of a multi-view video, or of a folder of captures, in the background. Each
    frame starts from the splats of the previous one"""

    bl_idname = "gscore.train_sequence"
    bl_label = "Train Sequence"

    resume: BoolProperty(
        name="Resume",
        description="Continue the sequence in the output folder",
        options={"SKIP_SAVE"},
    )
    overwrite: BoolProperty(
        name="Start Over",
        description="Replace the sequence in the output folder",
        options={"SKIP_SAVE"},
    )
    confirm = "Start Over"

    def confirm_lines(self, context: bpy.types.Context) -> list[str]:
        """List overwritten frames, and parts of the scene that the training would not use."""
        output = output_of(context.scene)
        lines = []
        if self.overwrite and is_started(output):
            lines = [f"The frames in {output} are replaced. This cannot be undone."]
        self.confirm = "Start Over" if lines else "Train Without"
        return lines if self.resume else lines + unsupported_parts(context.scene)

    def start(self, context: bpy.types.Context) -> VerbJob:
        """Start."""
        if not self.resume:
            self.warn(unsupported_parts(context.scene))
        return train_sequence(
            context.scene, resume=self.resume, overwrite=self.overwrite, wait=self.wait
        )


class StopSequence(Cancelling, bpy.types.Operator):
    """Stop after a checkpoint; complete frames are kept, and Resume continues from there"""

    bl_idname = "gscore.stop_sequence"
    bl_label = "Stop"
    none = "No sequence is being trained."
    job_of = staticmethod(job_of)


class TrainSequenceSettings(bpy.types.PropertyGroup):
    """Options of a sequence in addition to those of its frames."""

    frames: declared(
        SequenceOptions(),
        "frames",
        "Frames",
        default="",
        description="Frames to train: 0,5,12 or 0:30 or 0:30:5 (first, last, step); empty: all",
    )
    next_iterations: declared(SequenceOptions(), "next_iterations", "Steps of Later Frames")
    warm_start: declared(SequenceOptions(), "warm_start", "Start from the Frame Before")
    guide_start: bpy.props.IntProperty(
        name="First Guide Frame",
        description="Frame of the timeline at which the guide meshes match the first trained "
        "frame. Later frames of the sequence use later ones",
        default=1,
    )


PROPERTIES = (
    (
        bpy.types.Scene,
        "gscore_train_sequence",
        bpy.props.PointerProperty(type=TrainSequenceSettings),
    ),
)
