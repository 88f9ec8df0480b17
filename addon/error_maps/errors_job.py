"""Errors job: the measurement of a run as a background process, its progress and result; no bpy."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ..capture.figures import MEASURED, Figures
from ..core import EvalDone, EvalProgress, Event
from ..training.loader import Loader
from ..training.verb_job import VerbJob


class ErrorsJob(VerbJob):
    """One run of `gscore eval`; `source` is the folder of the training."""

    kept = "Stopped; nothing was measured."
    less = "close other programs, then measure again"

    def __init__(
        self,
        python: str | Path,
        arguments: Sequence[str],
        *,
        source: Path,
        after: VerbJob | None = None,
    ) -> None:
        """As `VerbJob`."""
        self.progress: EvalProgress | None = None
        self.done: EvalDone | None = None
        self.wanted = False
        """Whether the result is still to be imported."""
        self.loader = Loader()
        self.filling = None
        """The running import of the error map."""
        self.chores: list[Callable[[], Any]] = []
        """Preparations of the import that remain, one per poll."""
        super().__init__(python, arguments, source=source, after=after)

    @property
    def share(self) -> float:
        """Progress, 0 to 1."""
        now = self.progress
        return min(now.done / now.total, 1.0) if now is not None and now.total > 0 else 0.0

    @property
    def figures(self) -> Figures:
        """Figures of all photos, set when the job has finished."""
        views = {} if self.done is None else self.done.views
        return Figures(path=self.source / MEASURED / "metrics.json", views=views)

    def take(self, event: Event) -> None:
        """Process an event."""
        if isinstance(event, EvalProgress):
            self.progress = event
        elif isinstance(event, EvalDone):
            self.done = event

    def finish(self) -> str:
        """A sentence with the quality of the renders; empty if the job was cancelled."""
        if self.done is None:
            return ""
        self.wanted = True
        self.loader.request(Path(self.done.error_map), final=True)
        ranked = self.figures.ranked
        count = f"{len(self.done.views)} photos"
        if not ranked:
            return f"{count} are reproduced exactly."
        return f"{count}: {ranked[0][1]:.1f} dB (worst) to {ranked[-1][1]:.1f} dB (best)."
