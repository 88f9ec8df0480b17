"""Sequence job: `gscore sequence` as a background process, its current frame and result; no bpy."""

from collections.abc import Callable, Sequence
from pathlib import Path

from ..core import Event, FrameStarted, Progress, SequenceDone, headline_psnr
from ..training.verb_job import STOPPING, VerbJob

FINISHED = "finished"
"""Reason of a sequence that was completed."""


class SequenceJob(VerbJob):
    """The training of one sequence."""

    kept = "Stopped; complete frames are kept, and Resume continues from there."
    less = "choose fewer splats or smaller photos, then press Resume"

    def __init__(
        self,
        python: str | Path,
        arguments: Sequence[str],
        *,
        source: Path,
        output: Path,
        begun: Callable[[], object] = lambda: None,
    ) -> None:
        """Start the process.

        Args:
            python: The Python that has gscore.
            arguments: Of `gscore`.
            source: The sequence.
            output: Folder of the results.
            begun: Called when the trainer has passed its checks and begins, or has nothing left
                to do; never if a check fails.

        Raises:
            OSError: `python` cannot be run.
        """
        self.output = output
        self.frame: FrameStarted | None = None
        """The frame in training."""
        self.progress: Progress | None = None
        """Run state of that frame."""
        self._begun: Callable[[], object] | None = begun
        self.done: SequenceDone | None = None
        super().__init__(python, arguments, source=source)

    @property
    def share(self) -> float:
        """Progress, 0 to 1, by frames and the steps of the current frame."""
        if self.frame is None or self.frame.frames < 1:
            return 0.0
        now = self.progress
        within = now.step / now.iterations if now is not None and now.iterations > 0 else 0.0
        return min((self.frame.place - 1 + min(within, 1.0)) / self.frame.frames, 1.0)

    def take(self, event: Event) -> None:
        """Process an event."""
        if isinstance(event, FrameStarted | SequenceDone) and self._begun is not None:
            self._begun()
            self._begun = None
        if isinstance(event, FrameStarted):
            self.frame, self.progress = event, None
        elif isinstance(event, Progress):
            self.progress = event
        elif isinstance(event, SequenceDone):
            self.done = event

    def finish(self) -> str:
        """A sentence with the number of complete frames; empty if the job was stopped."""
        done = self.done
        if done is None or (done.reason != FINISHED and self.status == STOPPING):
            return ""
        psnr = headline_psnr(done.metrics)
        quality = "" if psnr is None else f", mean PSNR {psnr:.2f} dB"
        ended = "" if done.reason == FINISHED else f" It ended early: {done.reason}."
        return f"{done.frames:,} frames are complete{quality}.{ended}"
