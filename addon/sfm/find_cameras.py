"""Find cameras by SfM from scripts and operators: start, cancel, import the result."""

from dataclasses import dataclass
from pathlib import Path

import bpy

from .. import preferences
from ..cameras.importing import importing
from ..cameras.lookup import chosen_root
from ..cameras.select_imported import choose
from ..capture.folders import same_folder
from ..core import GsError, default_capture_output
from ..interface import editable_check, undo
from ..interface.incremental_operator import in_words
from ..interface.option_labels import error_words
from ..paths import absolute, capture_folder, relative
from ..process import poll_timer
from ..process.incremental_tasks import Pieces, TaskRunner
from ..training import facts, lookups, options
from ..training.launch import follow, launch
from .job import SearchJob
from .job_registry import JOBS


@dataclass(frozen=True, kw_only=True)
class Places:
    """Input and output paths of an SfM job."""

    source: Path
    """The photos or the video."""
    capture: Path
    """The capture made from them, in the same parent folder."""
    is_there: bool
    """True if the capture exists already."""


def places(scene: bpy.types.Scene) -> Places:
    """Input and output paths of SfM for the scene's photos or video.

    Args:
        scene: Its `gscore` settings name photos or a video.

    Raises:
        ValueError: an input is missing or invalid, or a job is running.
    """
    source = capture_folder(scene)
    capture, problem = facts.refresh(scene)
    if capture is None or not capture.bare:
        raise ValueError(
            problem or f"{source} is no folder of photos without cameras and no video."
        )
    if errors := [p.text for p in capture.problems if p.is_error]:
        raise ValueError(errors[0])
    if (other := JOBS.of_source(source)) is not None and other.busy:
        raise ValueError(f"The search for the cameras of {source} is running already.")
    output = default_capture_output(source)
    return Places(source=source, capture=output.capture, is_there=output.is_there)


def find(scene: bpy.types.Scene, where: Places, *, wait: bool = False) -> SearchJob:
    """Find the cameras of the scene's photos or video, and import them.

    Args:
        scene: Its `gscore` settings are used.
        where: Its paths; the capture must not exist yet.
        wait: Return when the job has ended and the cameras are imported.

    Raises:
        ValueError: the Python of the preferences is missing.
    """
    arguments = options.search(
        scene.gscore,
        source=where.source,
        capture=where.capture,
        threads=preferences.get().threads,
    )
    paths = {
        "source": where.source,
        "capture": where.capture,
        "scene_uid": scene.session_uid,
        "after": JOBS.of_source(where.source),
    }
    job = launch(lambda program: SearchJob(program, arguments, **paths), None)
    JOBS.add(job)
    poll_timer.ensure()
    follow(lambda: wait and (not job.ended or job.wanted))
    return job


def job_of(scene: bpy.types.Scene) -> SearchJob | None:
    """The last SfM job of the scene's photos, video or the capture made from them, running or
    ended."""
    try:
        chosen = absolute(scene.gscore.capture_path, "Capture")
    except ValueError:
        return None
    by_capture = (job for job in JOBS.jobs() if same_folder(job.capture, chosen))
    return JOBS.of_source(chosen) or next(by_capture, None)


def bring_in(job: SearchJob) -> bool:
    """Run the next step of importing a finished job's result; True if panels changed.

    Does nothing while Blender renders or a mesh is edited. If another capture is chosen or another
    file is opened before the import is complete, the cameras stay on disk only.
    """
    if not job.wanted or bpy.app.is_job_running("RENDER") or bpy.context.mode != "OBJECT":
        return False
    scenes = (scene for scene in bpy.data.scenes if scene.session_uid == job.scene_uid)
    scene = next((scene for scene in scenes if job_of(scene) is job), None)
    if scene is None:
        if job.coming is not None:
            job.coming.cancel()
        job.coming, job.wanted = None, False
        return True
    if job.coming is None:
        lookups.captures.expire()
        job.coming = TaskRunner(in_words(arriving(scene, job.capture)))
    ended = True
    try:
        ended = job.coming.step()
        if ended:
            job.warnings += job.coming.result
    except (GsError, ValueError, OSError) as error:
        job.warnings.append(error_words(error))
    finally:
        if ended:
            job.coming, job.wanted = None, False
    return ended


def arriving(scene: bpy.types.Scene, capture: Path) -> Pieces[tuple[str, ...]]:
    """Choose the capture, and import its cameras, points and photos unless the scene has them.

    Returns warnings for the user.

    Raises:
        GsError, ValueError, OSError: the import fails; the message is for the user.
    """
    scene.gscore.capture_path = relative(capture)
    scene.gscore.images = "images"
    facts.capture(scene)
    warnings: tuple[str, ...] = ()
    if chosen_root(scene) is None:
        editable_check.check(scene)
        # Not by an operator, which would act on the scene of a window.
        made = yield from importing(scene, absolute(scene.gscore.capture_path, "Capture"))
        choose(made.scene, made)
        warnings = made.warnings
    undo.push("Cameras Found")
    return warnings
