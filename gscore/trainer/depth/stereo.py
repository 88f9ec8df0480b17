"""Stereo start points: dense surface points from the photos, added to or instead of SfM points."""

from collections.abc import Callable
from dataclasses import dataclass

from ...config import Stereo, TrainConfig
from ...datasets import Dataset
from ...events import Decision
from ...sampling import evenly_spaced
from ...scene import PointCloud
from ...stereo import dense_points, stereo_maps
from ...text_format import count_text, number
from ..schedule.caps import max_stereo_points

_MOST_VIEWS = 120
"""Most photos used, evenly spaced: enough for this many points."""
_SIDE = 300
"""Longer side of the photos, px: small for speed, because errors of a pixel do not matter."""
_FEWEST = 100
"""Least number of points: fewer matches are mostly random."""
_CHANCE = 4e-4
"""Least share of matched pixels to prefer the points to random ones: photos of noise reach .0003,
a walk-through that profits from its points .0006."""


@dataclass(frozen=True, kw_only=True)
class StereoStart:
    """Result of stereo for the start points of a run."""

    points: PointCloud | None = None
    """Points of the capture, unless random, with those of stereo; None: nothing is added."""
    added: int = 0
    """Number of points of stereo."""
    known: float | None = None
    """Share of the unmasked pixels with a confirmed depth; None: stereo has not run."""
    decision: Decision | None = None
    """The number of added points or the reason for none; None without stereo."""

    def warnings_of(self, config: TrainConfig) -> tuple[str, ...]:
        """The decision, if stereo was requested and added nothing."""
        missed = self.decision is not None and not self.added and config.stereo == Stereo.ON
        return (self.decision.text,) if missed and self.decision else ()


def stereo_start(
    config: TrainConfig,
    photos: Dataset,
    known: PointCloud,
    *,
    on_view: Callable[[int, int], None] | None = None,
) -> StereoStart:
    """Compute start points from the training views alone.

    Args:
        config: Options; with `start_splats` nothing is added.
        photos: The capture.
        known: Start points without stereo.
        on_view: Called with (done, total) after each photo; may raise to stop.
    """
    given = known.given
    if config.start_splats is not None:
        return StereoStart()
    if not (known.made_up if config.stereo == Stereo.MISSING else config.stereo != Stereo.OFF):
        if config.stereo_points and config.stereo == Stereo.MISSING:
            return _nothing(f"the capture has {number(given)} (`--stereo on` adds more)")
        return StereoStart()
    most = max_stereo_points(config, given)
    if not most:
        return _nothing(f"{number(given)} points leave no room for more")
    used = evenly_spaced(photos.train, _MOST_VIEWS)
    found = stereo_maps(photos, used, side=_SIDE, threads=config.threads, on_view=on_view)
    if found.reason:
        return _nothing(found.reason, known=0.0)
    added = dense_points(found, most=most)
    by_chance = known.made_up and found.known < _CHANCE
    if len(added) < min(_FEWEST, most) or by_chance:
        return _nothing("photos agree on the depth of almost no pixels", known=found.known)
    return StereoStart(
        points=added if known.made_up else known.with_more(added),
        added=len(added),
        known=found.known,
        decision=Decision(
            "stereo",
            f"{count_text(len(added), 'stereo point')} "
            + (
                f"were added to {number(given)} of the capture."
                if given
                else "are the start points."
            ),
        ),
    )


def _nothing(why: str, *, known: float | None = None) -> StereoStart:
    text = f"No points were added by stereo: {why}."
    return StereoStart(known=known, decision=Decision("stereo", text))
