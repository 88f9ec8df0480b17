"""Region training job: a background process, its progress and result; no bpy."""

from collections.abc import Sequence
from pathlib import Path

from ..core import Done, Event, Progress, Started, headline_psnr
from ..training.loader import Loader
from ..training.verb_job import FAILED, STOPPING, VerbJob

FINISHED = ("finished", "converged", "target")
"""Reasons of trainings that came to their end."""


class RegionJob(VerbJob):
    """One region of one splat object."""

    kept = "Stopped; the splats stay as they were."
    less = "choose a smaller region or smaller photos, then train it again"

    def __init__(
        self,
        python: str | Path,
        arguments: Sequence[str],
        *,
        source: Path,
        output: Path,
        object_uid: int,
        before: str,
    ) -> None:
        """It starts with `begin`, once the files that it begins with are there.

        Args:
            python: The Python that has gscore.
            arguments: Of `gscore`.
            source: The capture.
            output: Folder of the results.
            object_uid: Session number of the object whose splats are trained.
            before: What tells whether these were edited since.
        """
        self.output, self.object_uid, self.before = output, object_uid, before
        self.start = None
        """The files that it begins with, until they are there."""
        self.started: Started | None = None
        self.progress: Progress | None = None
        self.done: Done | None = None
        self.wanted = False
        """Whether the result has to be brought into the scene."""
        self.loader = Loader()
        self.filling = None
        """The result on its way into the open file."""
        super().__init__(python, arguments, source=source, later=True)

    @property
    def share(self) -> float:
        """Part that is done, 0 to 1."""
        told = self.progress
        return min(told.step / told.iterations, 1.0) if told and told.iterations > 0 else 0.0

    def fail(self, sentence: str) -> None:
        """It cannot start, for a reason."""
        self.status, self.sentence = FAILED, sentence

    def take(self, event: Event) -> None:
        """Take note of an event."""
        if isinstance(event, Started):
            self.started = event
        elif isinstance(event, Progress):
            self.progress = event
        elif isinstance(event, Done):
            self.done = event

    def finish(self) -> str:
        """What was trained; empty where it was stopped."""
        done = self.done
        if done is None or (done.reason not in FINISHED and self.status == STOPPING):
            return ""
        self.wanted = True
        self.loader.request(Path(done.path), final=True)
        psnr = headline_psnr(done.metrics)
        quality = "" if psnr is None else f", PSNR {psnr:.2f} dB"
        return f"The region is trained: {done.step:,} steps{quality}. {self.output} has all of it."
