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
from .registry import JOBS


@dataclass(frozen=True, kw_only=True)
class Places:
    """Input and output paths of an SfM job."""

    source: Path
    """The photos or the video."""
    capture: Path
    """The capture made from them, in the same parent folder."""
    is_there: bool
    """Whether the capture exists already."""


def places(scene: bpy.types.Scene) -> Places:
    """Input and output paths of SfM for the scene's photos or video.

    Args:
        scene: Its `gscore` settings name photos or a video.

    Raises:
        ValueError: something is missing or in the way; the message says what to do.
    """
    source = capture_folder(scene)
    found, problem = facts.refresh(scene)
    if found is None or not found.bare:
        raise ValueError(problem or f"{source} holds no photos without cameras, and is no video.")
    if errors := [p.text for p in found.problems if p.is_error]:
        raise ValueError(errors[0])
    if (other := JOBS.of_source(source)) is not None and other.busy:
        raise ValueError(f"The cameras of {source} are being looked for already.")
    beside = default_capture_output(source)
    return Places(source=source, capture=beside.capture, is_there=beside.is_there)


def find(scene: bpy.types.Scene, where: Places, *, wait: bool = False) -> SearchJob:
    """Find the cameras of the scene's photos or video, and import them.

    Args:
        scene: Its `gscore` settings are used.
        where: Its paths; the capture must not exist yet.
        wait: Return when the job has ended and the cameras are imported.

    Raises:
        ValueError: the Python of the preferences is missing; the message says what to do.
    """
    arguments = options.search(
        scene.gscore,
        source=where.source,
        capture=where.capture,
        threads=preferences.get().threads,
    )
    given = {
        "source": where.source,
        "capture": where.capture,
        "scene_uid": scene.session_uid,
        "after": JOBS.of_source(where.source),
    }
    job = launch(lambda program: SearchJob(program, arguments, **given), None)
    JOBS.add(job)
    poll_timer.ensure()
    follow(lambda: wait and (not job.ended or job.wanted))
    return job


def job_of(scene: bpy.types.Scene) -> SearchJob | None:
    """The last search for the cameras of the scene's photos or video, or of the capture made of
    them, running or ended."""
    try:
        chosen = absolute(scene.gscore.capture_path, "Capture")
    except ValueError:
        return None
    made = (job for job in JOBS.jobs() if same_folder(job.capture, chosen))
    return JOBS.of_source(chosen) or next(made, None)


def bring_in(job: SearchJob) -> bool:
    """Do the next step of importing a finished job's result into the scene, if nothing blocks it;
    return whether panels changed.

    Nothing is touched while Blender renders or a mesh is edited. Where another capture is chosen
    before the import is complete, or another file is opened, the cameras stay on the disk.
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
    """Choose the capture, and import its cameras, points and photos unless they are there;
    return warnings for the user.

    Raises:
        GsError, ValueError, OSError: they cannot be imported; the message is for the user.
    """
    scene.gscore.capture_path = relative(capture)
    scene.gscore.images = "images"
    facts.capture(scene)
    warnings: tuple[str, ...] = ()
    if chosen_root(scene) is None:
        editable_check.check(scene)
        # No operator, which would act on the scene of a window.
        made = yield from importing(scene, absolute(scene.gscore.capture_path, "Capture"))
        choose(made.scene, made)
        warnings = made.warnings
    undo.push("Cameras Found")
    return warnings
