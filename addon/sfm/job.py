"""SfM job: `gscore sfm` as a background process, its progress and result; no bpy."""

import math
import time
from collections.abc import Sequence
from pathlib import Path

from ..core import Event, FramesDone, FramesProgress, SfmDone, SfmEstimated, SfmProgress
from ..process.incremental_tasks import TaskRunner
from ..training.verb_job import VerbJob


class SearchJob(VerbJob):
    """One SfM job for the photos of a folder or for a video."""

    kept = "Cancelled; the results so far are kept, and Find Cameras continues from there."
    less = "close other programs, then press Find Cameras again"

    def __init__(
        self,
        python: str | Path,
        arguments: Sequence[str],
        *,
        source: Path,
        capture: Path,
        scene_uid: int,
        after: VerbJob | None = None,
    ) -> None:
        """Start the process.

        Args:
            python: The Python that has gscore.
            arguments: Arguments of `gscore`.
            source: The photos or the video.
            capture: The capture to make.
            scene_uid: Session uid of the scene that started the job.
            after: As `VerbJob`.

        Raises:
            OSError: `python` cannot be run.
        """
        self.capture, self.scene_uid = capture, scene_uid
        self.progress: SfmProgress | FramesProgress | None = None
        self.frames: FramesDone | None = None
        """Frames extracted from a video."""
        self.estimated: SfmEstimated | None = None
        self.done: SfmDone | None = None
        self.wanted = False
        """True while the import of the cameras is pending."""
        self.coming: TaskRunner | None = None
        """The running import of the cameras."""
        self._began = time.monotonic()
        super().__init__(python, arguments, source=source, after=after)

    @property
    def share(self) -> float:
        """Progress from 0 to 1: of the whole job if reported, else of the phase."""
        last = self.progress
        whole = getattr(last, "share", None)
        if whole is not None and math.isfinite(whole):
            return whole
        return min(last.done / last.total, 1.0) if last is not None and last.total > 0 else 0.0

    @property
    def left(self) -> float | None:
        """Remaining seconds: of the whole job if reported, else of the phase."""
        for name in ("left_s", "eta_s"):
            seconds = getattr(self.progress, name, None)
            if seconds is not None and math.isfinite(seconds):
                return seconds
        return None

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self._began

    def take(self, event: Event) -> None:
        """Process an event."""
        if isinstance(event, SfmProgress | FramesProgress):
            self.progress = event
        elif isinstance(event, FramesDone):
            self.frames = event
        elif isinstance(event, SfmEstimated):
            self.estimated = event
        elif isinstance(event, SfmDone):
            self.done = event

    def takes(self, other: VerbJob) -> bool:
        """Take over the result of another job; True if there was one."""
        self.done = other.done if isinstance(other, SearchJob) else None
        return self.done is not None

    def finish(self) -> str:
        """A sentence with the number of photos that have a camera."""
        done = self.done
        if done is None:
            return ""
        self.wanted = True
        rest = "" if done.registered == done.photos else "; the others are left out"
        return (
            f"{done.registered} of {done.photos} photos have a camera{rest}: {done.points:,} "
            f"points, mean error {done.reprojection_px:.2f} px."
        )
