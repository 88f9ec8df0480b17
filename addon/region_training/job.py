"""Region training job: a background process, its progress and result; no bpy."""

from collections.abc import Sequence
from pathlib import Path

from ..core import Done, Event, Progress, Started, headline_psnr
from ..training.loader import Loader
from ..training.verb_job import FAILED, STOPPING, VerbJob

FINISHED = ("finished", "converged", "target")
"""Reasons of trainings that were completed."""


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
        """Prepare the job; `begin` starts it when its start files are written.

        Args:
            python: The Python that has gscore.
            arguments: Of `gscore`.
            source: The capture.
            output: Folder of the results.
            object_uid: Session uid of the object whose splats are trained.
            before: Fingerprint of the splats, to detect later edits.
        """
        self.output, self.object_uid, self.before = output, object_uid, before
        self.start = None
        """The start files being written; None when complete."""
        self.started: Started | None = None
        self.progress: Progress | None = None
        self.done: Done | None = None
        self.wanted = False
        """Whether the result is still to be imported."""
        self.loader = Loader()
        self.filling = None
        """The running import of the result."""
        super().__init__(python, arguments, source=source, later=True)

    @property
    def share(self) -> float:
        """Progress, 0 to 1."""
        now = self.progress
        return min(now.step / now.iterations, 1.0) if now and now.iterations > 0 else 0.0

    def fail(self, sentence: str) -> None:
        """End the job with an error, because it cannot start."""
        self.status, self.sentence = FAILED, sentence

    def take(self, event: Event) -> None:
        """Process an event."""
        if isinstance(event, Started):
            self.started = event
        elif isinstance(event, Progress):
            self.progress = event
        elif isinstance(event, Done):
            self.done = event

    def finish(self) -> str:
        """A sentence on the result; empty if the job was stopped."""
        done = self.done
        if done is None or (done.reason not in FINISHED and self.status == STOPPING):
            return ""
        self.wanted = True
        self.loader.request(Path(done.path), final=True)
        psnr = headline_psnr(done.metrics)
        quality = "" if psnr is None else f", PSNR {psnr:.2f} dB"
        return f"The region is trained: {done.step:,} steps{quality}. Results are in {self.output}."
