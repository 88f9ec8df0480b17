"""The search for cameras from scripts and operators: begin, cancel, bring in what was found."""

from collections.abc import Callable, Iterable
from pathlib import Path

import bpy

from .. import preferences
from ..cameras.captures import import_capture
from ..cameras.choosing import choose
from ..cameras.lookup import chosen_root
from ..capture.folders import same_folder
from ..core import GsError, capture_beside
from ..interface import undo, writable
from ..interface.flags import error_words
from ..job import facts, lookups, options
from ..job.launch import follow, launch
from ..paths import absolute, capture_folder, relative
from ..process import beat
from .job import SearchJob
from .registry import JOBS


def find(
    scene: bpy.types.Scene,
    *,
    wait: bool = False,
    python: str | Path | None = None,
    warn: Callable[[Iterable[str]], None] = tuple,
) -> SearchJob | None:
    """Find the cameras of the scene's photos or video, and bring them in.

    The capture is made beside the source; where one was made of it before, that is taken at once.

    Args:
        scene: Its `gscore` settings name photos or a video.
        wait: Return when it has ended and the cameras are there.
        python: The Python that searches; None: as the preferences say.
        warn: Told what the user should know of a capture that is taken at once.

    Returns:
        The search; None: there was nothing to search for.

    Raises:
        ValueError: something is missing or in the way; the message says what to do.
    """
    source = capture_folder(scene)
    found, problem = facts.look_again(scene)
    if found is None or not found.bare:
        raise ValueError(problem or f"{source} holds no photos without cameras, and is no video.")
    if errors := [p.text for p in found.problems if p.is_error]:
        raise ValueError(errors[0])
    if (other := JOBS.of_source(source)) is not None and not other.ended:
        raise ValueError(f"The cameras of {source} are being looked for already.")
    beside = capture_beside(source)
    if beside.is_there:
        warn(_arrive(scene, beside.capture))
        return None
    arguments = options.search(
        scene.gscore, source=source, capture=beside.capture, threads=preferences.get().threads
    )
    places = {"source": source, "capture": beside.capture, "scene_uid": scene.session_uid}
    job = launch(lambda program: SearchJob(program, arguments, **places), python)
    JOBS.add(job)
    beat.ensure()
    follow(lambda: wait and (not job.ended or job.wanted))
    return job


def job_of(scene: bpy.types.Scene) -> SearchJob | None:
    """The last search for the cameras of the scene's photos or video, or of the capture made of
    them, under way or ended."""
    try:
        chosen = absolute(scene.gscore.capture_path, "Capture")
    except ValueError:
        return None
    places = (job for job in JOBS.jobs() if same_folder(job.capture, chosen))
    return JOBS.of_source(chosen) or next(places, None)


def bring_in(job: SearchJob) -> bool:
    """Bring in what a search has found, when nothing is in the way; whether it did.

    Nothing is touched while Blender renders or a mesh is edited. Where another capture has been
    chosen meanwhile, or another file opened, the cameras stay on the disk.
    """
    if not job.wanted or bpy.app.is_job_running("RENDER") or bpy.context.mode != "OBJECT":
        return False
    job.wanted = False
    scenes = [scene for scene in bpy.data.scenes if scene.session_uid == job.scene_uid]
    for scene in scenes:
        if job_of(scene) is job:
            lookups.captures.expire()
            try:
                job.warnings += _arrive(scene, job.capture)
            except (GsError, ValueError, OSError) as error:
                job.warnings.append(error_words(error))
    return True


def _arrive(scene: bpy.types.Scene, capture: Path) -> tuple[str, ...]:
    """Choose the capture, and import its cameras, points and photos unless they are there; what
    the user should know besides.

    Raises:
        GsError, ValueError, OSError: they cannot be imported; the message is for the user.
    """
    scene.gscore.capture_path = relative(capture)
    scene.gscore.images = "images"
    facts.capture(scene)
    warnings: tuple[str, ...] = ()
    if chosen_root(scene) is None:
        writable.check(scene)
        # No operator, which would act on the scene of a window.
        made = import_capture(scene, absolute(scene.gscore.capture_path, "Capture"))
        choose(scene, made)
        warnings = made.warnings
    undo.push("Cameras Found")
    return warnings
