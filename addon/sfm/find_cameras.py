"""Find cameras by SfM: choose a video, start, cancel, import the result; functions for scripts, and
operators.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import bpy
from bpy.props import StringProperty

from .. import preferences
from ..cameras.captures import choose
from ..cameras.importing import importing
from ..cameras.lookup import chosen_root
from ..capture.folders import same_folder
from ..core import VIDEO_ENDINGS, FramesProgress, SfmDone, SfmProgress, default_capture_output
from ..interface import editable_check
from ..interface.base_operator import Browsing, OnScene, Waiting
from ..interface.incremental_operator import IncrementalOperator
from ..interface.sidebar import choose_tab, in_turn, open_sidebar
from ..interface.windows import push_undo
from ..paths import absolute, capture_folder, relative
from ..process.incremental_tasks import Steps
from ..training import facts, lookups, options
from ..training.verb_job import Verb, VerbJob
from ..training.verb_jobs import JOBS, Cancelling, ended


def _message(job: VerbJob) -> str:
    """A sentence with the number of photos that have a camera."""
    done = job.done
    rest = "" if done.registered == done.photos else "; the others are left out"
    return (
        f"{done.registered} of {done.photos} photos have a camera{rest}: {done.points:,} points, "
        f"mean error {done.reprojection_px:.2f} px."
    )


VERB = Verb(
    running="The search for the cameras of {} is running already.",
    kept="Cancelled; the results so far are kept, and Find Cameras continues from there.",
    less="close other programs, then press Find Cameras again",
    progress=(SfmProgress, FramesProgress),
    done=SfmDone,
    message=_message,
    waits=True,
    adopts=True,
    has_place=lambda job: _scene_of(job) is not None,
    expires=(lookups.captures,),
)
"""`gscore sfm` for the photos of a folder or for a video."""


@dataclass(frozen=True, kw_only=True)
class Places:
    """Input and output paths of an SfM job."""

    source: Path
    """The photos or the video."""
    capture: Path
    """The capture made from them, in the same parent folder."""
    exists: bool
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
            problem or f"{source} is neither a folder of photos without cameras nor a video."
        )
    if errors := [p.text for p in capture.problems if p.is_error]:
        raise ValueError(errors[0])
    output = default_capture_output(source)
    if not output.exists:
        JOBS.check_free(VERB, source)
    return Places(source=source, capture=output.capture, exists=output.exists)


def find(scene: bpy.types.Scene, where: Places, *, wait: bool = False) -> VerbJob:
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
    return JOBS.start(
        VERB,
        arguments,
        source=where.source,
        output=where.capture,
        scene_uid=scene.session_uid,
        arrive=_coming,
        wait=wait,
    )


def job_of(scene: bpy.types.Scene) -> VerbJob | None:
    """The last SfM job of the scene's photos, video or the capture made from them, running or
    ended."""
    try:
        chosen = absolute(scene.gscore.capture_path, "Capture")
    except ValueError:
        return None
    by_capture = (job for job in JOBS.jobs(VERB) if same_folder(job.output, chosen))
    return JOBS.of_source(VERB, chosen) or next(by_capture, None)


def _coming(job: VerbJob) -> Steps[Iterable[str]]:
    """Import the cameras that a job found."""
    lookups.captures.expire()
    return (yield from importing_capture(_scene_of(job), job.output))


def _scene_of(job: VerbJob) -> bpy.types.Scene | None:
    """The scene that started a job; None if another capture was chosen or another file opened."""
    scenes = (scene for scene in bpy.data.scenes if scene.session_uid == job.scene_uid)
    return next((scene for scene in scenes if job_of(scene) is job), None)


def importing_capture(scene: bpy.types.Scene, capture: Path) -> Steps[tuple[str, ...]]:
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
    push_undo("Cameras Found")
    return warnings


class ChooseVideo(Browsing, OnScene, bpy.types.Operator):
    """Choose a video filmed around the subject; its sharp frames become the photos"""

    bl_idname = "gscore.choose_video"
    bl_label = "Choose Video"
    given = ("filepath",)

    filepath: StringProperty(
        name="Video",
        description="File of the video",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"},
    )
    directory: StringProperty(
        name="Folder", description="Folder of photos", subtype="DIR_PATH", options={"SKIP_SAVE"}
    )
    filter_glob: StringProperty(
        default=";".join(f"*{end}" for end in VIDEO_ENDINGS), options={"HIDDEN"}
    )

    def run(self, context: bpy.types.Context) -> None:
        """Choose the video, and show the panel."""
        text = self.filepath or self.directory
        chosen = Path(bpy.path.abspath(text))
        if not text.strip():
            raise ValueError("No video is chosen; choose a file.")
        if not chosen.exists():
            raise ValueError(f"There is no video {chosen}; choose a file.")
        context.scene.gscore.capture_path = relative(chosen.absolute())
        if context.area is not None and context.area.type == "VIEW_3D":  # a file was dropped on it
            in_turn(context.area, open_sidebar, choose_tab)


class FindCameras(Waiting, IncrementalOperator, OnScene, bpy.types.Operator):
    """Find the camera of each photo by structure from motion, in the background.
    From a video, sharp frames are extracted first"""

    bl_idname = "gscore.find_cameras"
    bl_label = "Find Cameras"

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Start the job, or import an earlier result."""
        scene = context.scene
        where = places(scene)
        if where.exists:
            self.warn((yield from importing_capture(scene, where.capture)))
            return "Imported the cameras of an earlier search."
        return ended(find(scene, where, wait=self.wait))


class CancelSearch(Cancelling, bpy.types.Operator):
    """Cancel the search; its results are kept, and Find Cameras continues from there"""

    bl_idname = "gscore.cancel_search"
    bl_label = "Cancel"
    none = "No search for cameras is running."
    job_of = staticmethod(job_of)


class VideoHandler(bpy.types.FileHandler):
    """Choose a video that is dropped on a 3D view"""

    bl_idname = "GSCORE_FH_video"
    bl_label = "Video for Splats"
    bl_import_operator = "gscore.choose_video"
    bl_file_extensions = ";".join(VIDEO_ENDINGS)

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """True in 3D views."""
        return context.area is not None and context.area.type == "VIEW_3D"
