"""A dense start: points of surfaces that the photos themselves show, beside those of SfM, or in
their place where there are none."""

from collections.abc import Callable
from dataclasses import dataclass

from ...config import Stereo, TrainConfig
from ...datasets import Dataset
from ...scene import PointCloud
from ...stereo import dense_points, stereo_maps
from ...words import count_words, number
from ..photos.views import evenly
from .points import MOST_ADDED, SPLATS_A_POINT

_MOST_VIEWS = 120
"""Photos that take part; of more, this many at even distances: enough for so few points."""
_SIDE = 300
"""Longer side of the photos, pixels: points may be a pixel off, and time is short."""
_FEWEST = 100
"""Fewer points than this are no surface: what few places agree on is mostly chance."""


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
    if config.start_splats is not None or not _asked(config.stereo, known):
        return StereoStart()
    given = 0 if known.made_up else len(known)
    most = _wanted(config, given)
    if most <= 0:
        return _nothing(f"{number(given)} points leave no room for more")
    used = evenly(photos.train, _MOST_VIEWS)
    found = stereo_maps(photos, used, side=_SIDE, threads=config.threads, on_view=on_view)
    if found.reason:
        return _nothing(found.reason, known=0.0)
    added = dense_points(found, most=most)
    if len(added) < min(_FEWEST, most):
        return _nothing("photos agree on the depth of hardly anything", known=found.known)
    return StereoStart(
        points=known.with_more(added),
        added=len(added),
        known=found.known,
        why=f"{count_words(len(added), 'point')} of surfaces that photos agree on "
        + (f"were added to {number(given)} of the capture." if given else "are started from."),
    )


def points_to_expect(config: TrainConfig, known: PointCloud) -> int:
    """How many of the capture's points a run starts from, before photos are compared."""
    gives_up = known.made_up and config.stereo is not Stereo.OFF
    return _wanted(config, 0) if gives_up else len(known)


def _asked(stereo: Stereo, known: PointCloud) -> bool:
    return known.made_up if stereo is Stereo.MISSING else stereo is not Stereo.OFF


def _wanted(config: TrainConfig, given: int) -> int:
    room = config.max_splats - given
    if config.stereo is Stereo.AUTO and room < config.max_splats // 2:
        return 0
    return min(config.stereo_points or min(MOST_ADDED, config.max_splats // SPLATS_A_POINT), room)


def _nothing(why: str, *, known: float | None = None) -> StereoStart:
    return StereoStart(known=known, why=f"No points were added by stereo: {why}.")
