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
        """Whether the result has to be brought into the scene."""
        self.loader = Loader()
        self.filling = None
        """The map on its way into the open file."""
        self.chores: list[Callable[[], Any]] = []
        """What is to be made ready in it before, one at a beat."""
        super().__init__(python, arguments, source=source, after=after)

    @property
    def share(self) -> float:
        """Part that is done, 0 to 1."""
        told = self.progress
        return min(told.done / told.total, 1.0) if told is not None and told.total > 0 else 0.0

    @property
    def figures(self) -> Figures:
        """Of all photos, once it has finished."""
        views = {} if self.done is None else self.done.views
        return Figures(path=self.source / MEASURED / "metrics.json", views=views)

    def take(self, event: Event) -> None:
        """Take note of an event."""
        if isinstance(event, EvalProgress):
            self.progress = event
        elif isinstance(event, EvalDone):
            self.done = event

    def finish(self) -> str:
        """How good the photos are met; empty where it was stopped."""
        if self.done is None:
            return ""
        self.wanted = True
        self.loader.request(Path(self.done.error_map), final=True)
        ranked = self.figures.ranked
        count = f"{len(self.done.views)} photos"
        if not ranked:
            return f"{count} are met exactly."
        return f"{count}: {ranked[0][1]:.1f} dB (worst) to {ranked[-1][1]:.1f} dB (best)."
