"""Stereo start points: dense surface points from the photos, added to or instead of SfM points."""

from collections.abc import Callable
from dataclasses import dataclass

from ...config import Stereo, TrainConfig
from ...datasets import Dataset
from ...scene import PointCloud
from ...stereo import dense_points, stereo_maps
from ...text_format import count_words, number
from ..photos.view_sampler import evenly_spaced
from ..schedule.caps import max_stereo_points

_MOST_VIEWS = 120
"""Photos that take part; of more, this many at even distances: enough for so few points."""
_SIDE = 300
"""Longer side of the photos, pixels: points may be a pixel off, and time is short."""
_FEWEST = 100
"""Fewer points than this are no surface: what few places agree on is mostly chance."""
_CHANCE = 4e-4
"""Share of the pixels from which on points are worth more than random ones: photos of noise agree
on up to .0003, and those of a walk that gains by its points on .0006."""


@dataclass(frozen=True, kw_only=True)
class StereoStart:
    """What stereo adds to the points that a run starts from."""

    points: PointCloud | None = None
    """Those of the capture, unless they are made up, and more; None: nothing is added."""
    added: int = 0
    known: float | None = None
    """Share of the pixels that masks leave whose depth others confirm; None: nobody looked."""
    why: str = ""
    """A sentence that says how many were added, or why none were; empty where nobody asks."""


def stereo_start(
    config: TrainConfig,
    photos: Dataset,
    known: PointCloud,
    *,
    on_view: Callable[[int, int], None] | None = None,
) -> StereoStart:
    """Points to start from, by the training views alone.

    Args:
        config: How to train; `start_splats` leave nothing to add.
        photos: The capture.
        known: Points that the run starts from otherwise.
        on_view: Called with (done, total) after each photo; may raise to stop.
    """
    given = known.given
    if config.start_splats is not None:
        return StereoStart()
    if not _asked(config.stereo, known):
        if config.stereo_points and config.stereo == Stereo.MISSING:
            return _nothing(f"the capture has {number(given)} (--stereo on looks for more)")
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
        return _nothing("photos agree on the depth of hardly anything", known=found.known)
    return StereoStart(
        points=added if known.made_up else known.with_more(added),
        added=len(added),
        known=found.known,
        why=f"{count_words(len(added), 'point')} of surfaces that photos agree on "
        + (f"were added to {number(given)} of the capture." if given else "are started from."),
    )


def _asked(stereo: Stereo, known: PointCloud) -> bool:
    return known.made_up if stereo == Stereo.MISSING else stereo != Stereo.OFF


def _nothing(why: str, *, known: float | None = None) -> StereoStart:
    return StereoStart(known=known, why=f"No points were added by stereo: {why}.")
