"""Whether the exposure of photos is learnt: how much they differ decides, and gains begin there."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...config import Switch, TrainConfig
from ...datasets import Dataset
from ...datasets.dataset import map_threads
from ...datasets.tracks import tracks_of
from ...io.exposure_exif import stated_exposure
from .gains import PhotoGains
from .seeds import fit_gains
from .sightings import Sightings, sightings

LEAST = 0.08
"""Stops that photos lie apart, as a standard deviation, from which on their exposure is learnt:
light that depends on the direction it is looked at from makes 0.04 of photos exposed alike."""
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


def prepare_exposure(config: TrainConfig, photos: Dataset) -> Exposure:
    """Find how the training photos were exposed, and decide whether that is learnt.

    Raises:
        DatasetError, FormatError: a photo cannot be read.
    """
    if config.exposure is Switch.OFF:
        return Exposure()
    train = list(photos.train)
    stated = _stated(photos, train, config.threads)
    seen = _seen(photos, train, config.threads)
    measured = (
        seen is not None and np.median(np.bincount(seen.view, minlength=len(train))) >= _SHARED
    )
    expected = np.zeros((len(train), 3)) if stated is None else stated
    found = fit_gains(seen, expected) if measured and seen is not None else expected
    known = "points seen in several photos" if measured else "EXIF" if stated is not None else ""
    apart = _spread(found)
    learns, why = decide(config.exposure, apart, known=known)
    log_gains = np.zeros((len(photos), 3))
    log_gains[train] = found
    return Exposure(
        gains=PhotoGains(train, log_gains) if learns else None,
        why=why,
        numbers={"learnt": learns, "why": why, "stops_apart": apart, "known_by": known or None},
    )


def decide(mode: Switch, apart: float, *, known: str) -> tuple[bool, str]:
    """Whether to learn exposures, and a sentence that says so and why.

    Args:
        mode: The option `exposure`.
        apart: Standard deviation of the photos' exposures, stops; where they are not known 0.
        known: By what they are known; empty: they are not.
    """
    fact = f"{apart:.2f} stops apart by {known}"
    if mode is Switch.ON:
        return True, f"The exposure of each photo is learnt ({fact if known else 'asked for'})."
    if not known:
        return False, (
            "How the photos were exposed is not known: no points are seen in several of them, nor "
            "does EXIF say so. Their colours are taken as they are; --exposure on learns them."
        )
    if apart < LEAST:
        return False, (
            f"The photos are exposed alike ({fact}), so their colours are taken as they are."
        )
    return True, (
        f"The photos are exposed differently ({fact}), so the exposure of each is learnt; new "
        f"views get the mean one. --exposure off takes colours as they are."
    )


def _spread(log_gains: np.ndarray) -> float:
    """Root of the mean square of ln gains [V, 3] about their mean, in stops."""
    if not len(log_gains):
        return 0.0
    return float(np.sqrt(((log_gains - log_gains.mean(axis=0)) ** 2).mean())) / _STOP


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


def _seen(photos: Dataset, train: list[int], threads: int) -> Sightings | None:
    tracks = tracks_of(photos)
    return None if tracks is None else sightings(photos, tracks, train, threads=threads)
