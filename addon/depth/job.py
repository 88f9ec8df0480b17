"""Depth job: `gscore depth` as a background process, its progress and result; no bpy."""

from ..capture import depth_maps
from ..capture.depth_maps import DepthReport
from ..core import DepthDone, DepthProgress, Event
from ..interface.option_labels import panel_words
from ..training.verb_job import VerbJob


class DepthJob(VerbJob):
    """One run of `gscore depth`; never leaves a partly written map."""

    kept = "Cancelled; finished maps are kept."
    less = "choose a smaller network, then predict again"
    progress: DepthProgress | None = None
    report: DepthReport | None = None
    """The depth report, set when the job has finished."""
    done: DepthDone | None = None

    @property
    def share(self) -> float:
        """Progress of the current phase, 0 to 1."""
        last = self.progress
        return min(last.done / last.total, 1.0) if last is not None and last.total > 0 else 0.0

    def take(self, event: Event) -> None:
        """Process an event."""
        if isinstance(event, DepthProgress):
            self.progress = event
        elif isinstance(event, DepthDone):
            self.done = event

    def finish(self) -> str:
        """A sentence with the number of maps, and of accepted maps.

        Raises:
            ValueError: the report is invalid.
        """
        if self.done is None:
            return ""
        self.report = depth_maps.from_table(self.done.table, why=panel_words(self.done.why))
        return _sentence(self.done, self.report)


def _sentence(done: DepthDone, report: DepthReport) -> str:
    maps = len(report.rows) - report.counts[depth_maps.MISSING]
    made = f"{done.predicted} maps predicted. " if done.predicted else ""
    return f"{made}{done.accepted} of {maps} maps are accepted."
