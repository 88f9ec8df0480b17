"""Exposure decision: whether photo gains are learnt, from their differences, and initial gains."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...config import Switch, TrainConfig
from ...datasets import Dataset
from ...datasets.dataset import map_threads
from ...datasets.tracks import Tracks
from ...io.images.exposure_exif import stated_exposure
from .gain_fit import fit_gains
from .photo_gains import PhotoGains
from .track_colors import measure_track_colors

LEAST_STOPS = 0.2
"""Stops between photos and their neighbours from which on exposure is learnt. Below, colours that
depend on the view follow the exposures, which gains by hand measured no better."""
FAR_STOPS = 1.0
"""Stops between one photo and its neighbours from which on exposure is learnt, however alike the
others are."""
_NEIGHBOURS = 4
"""Photos taken nearest to one, that it is compared with."""
_SHARED = 20
"""Sightings of a median photo below which its points tell nothing."""
_STOP = math.log(2.0) / 2.2
"""ln of the gain in encoded values that a stop is."""


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """The exposure of the photos of a run."""

    gains: PhotoGains | None = None
    """What is learnt; None: photos are taken as they are."""
    why: str = ""
    """A sentence that says so and why; empty: nobody asked."""
    numbers: dict[str, Any] | None = None
    """For metrics.json; None: nobody asked."""


def prepare_exposure(config: TrainConfig, photos: Dataset, tracks: Tracks | None) -> Exposure:
    """Find how the training photos were exposed, and decide whether that is learnt.

    Args:
        config: Its option `exposure` says what is asked for.
        photos: Of the capture.
        tracks: The points that its views saw; None where nothing is known of them.

    Raises:
        DatasetError, FormatError: a photo cannot be read.
    """
    if config.exposure is Switch.OFF:
        return Exposure()
    train = list(photos.train)
    stated = _stated(photos, train, config.threads)
    seen = (
        None
        if tracks is None
        else measure_track_colors(photos, tracks, train, threads=config.threads)
    )
    measured = (
        seen is not None and np.median(np.bincount(seen.view, minlength=len(train))) >= _SHARED
    )
    expected = np.zeros((len(train), 3)) if stated is None else stated
    found = fit_gains(seen, expected) if measured and seen is not None else expected
    known = "points seen in several photos" if measured else "EXIF" if stated is not None else ""
    off = stops_off_neighbours(found, photos.scene.cameras.centers[train])
    apart = float(np.sqrt((off**2).mean())) if len(off) else 0.0
    learns, why = learns_exposure(config.exposure, apart, float(off.max(initial=0.0)), known=known)
    log_gains = np.zeros((len(photos), 3))
    log_gains[train] = found
    return Exposure(
        gains=PhotoGains(train, log_gains) if learns else None,
        why=why,
        numbers={"learnt": learns, "why": why, "stops_apart": apart, "known_by": known or None},
    )


def learns_exposure(mode: Switch, apart: float, farthest: float, *, known: str) -> tuple[bool, str]:
    """Whether to learn exposures, and a sentence that says so and why.

    Args:
        mode: The option `exposure`.
        apart: Root of the mean square of `stops_off_neighbours`; where exposures are not known 0.
        farthest: The largest of these.
        known: By what they are known; empty: they are not.
    """
    fact = f"{apart:.2f} stops apart, the farthest {farthest:.2f}, by {known}"
    if mode is Switch.ON:
        return True, f"The exposure of each photo is learnt ({fact if known else 'asked for'})."
    if not known:
        return False, (
            "How the photos were exposed is not known: no points are seen in several of them, nor "
            "does EXIF say so. Their colours are taken as they are; --exposure on learns them."
        )
    if apart < LEAST_STOPS and farthest < FAR_STOPS:
        return False, (
            f"Photos side by side are exposed much alike ({fact}), so their colours are taken as "
            "they are."
        )
    return True, (
        f"Photos side by side are exposed differently ({fact}), so the exposure of each is learnt; "
        "new views get the mean one. --exposure off takes colours as they are."
    )


def stops_off_neighbours(log_gains: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """How differently each photo is exposed from those that were taken nearest to it: on average
    the standard deviation where exposures are random, and little where they change smoothly along
    the camera's way, which view-dependent colour follows.

    Args:
        log_gains: [V, 3] ln gains in encoded values.
        centers: [V, 3] places of the cameras, any unit.

    Returns:
        [V] float64, stops, root of the mean square over the channels.
    """
    from scipy.spatial import KDTree

    others = min(_NEIGHBOURS, len(log_gains) - 1)
    if others < 1:
        return np.zeros(len(log_gains))
    near = np.array(KDTree(centers).query(centers, k=others + 1)[1])
    own = np.arange(len(near))[:, None]
    # Of cameras in one place any may come first; each is left out of its own neighbours.
    near[:, -1] = np.where((near == own).any(axis=1), near[:, -1], own[:, 0])
    mean = (log_gains[near].sum(axis=1) - log_gains) / others
    return np.sqrt(((log_gains - mean) ** 2).mean(axis=1) / (1 + 1 / others)) / _STOP


def _stated(photos: Dataset, train: Sequence[int], threads: int) -> np.ndarray | None:
    """[V, 3] ln gains by EXIF, zero on average; None unless all photos state theirs."""
    files = [photos.files[i].image for i in train]
    if not files or stated_exposure(files[0]) is None:
        return None
    stops = list(
        map_threads(lambda k: stated_exposure(files[k]), [*range(len(files))], threads=threads)
    )
    if any(value is None for value in stops):
        return None
    values = np.array(stops, np.float64)
    return np.repeat((values - values.mean())[:, None] * _STOP, 3, axis=1)
