"""Frame selection: the sharpest frame of each section of the camera motion."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .frame_survey import Survey

SPACING = 0.05
"""Default camera motion between two frames, share of the longer side."""
FEWEST, MOST = 30, 300
"""Range of the default number of frames."""
_BLURRED = 0.45
"""Frames with less than this share of the detail of sharp frames nearby are blurred."""
_NEARBY = 3.0
"""Window of nearby frames to each side, seconds."""
_SHARP = 75
"""Percentile of the detail nearby that counts as sharp."""
_MIN_DISTANCE = 0.35
"""Least motion between two frames, in sections."""
_CENTRE = 0.5
"""Reduction of the weight of a frame at the end of its section, relative to the middle."""


@dataclass(frozen=True, kw_only=True)
class Choice:
    """Selected frames, and statistics of the others."""

    frames: np.ndarray
    """[k] int64, numbers of the frames from 0, ascending."""
    sharpness: np.ndarray
    """[n] float64: detail as a share of that of sharp frames nearby."""
    blurred: int
    """Number of frames that were too blurred."""
    repeated: int
    """Number of frames equal to the one before."""
    gaps: list[tuple[float, float]]
    """Start and end in seconds of parts with camera motion but without sharp frames."""


def choose(survey: Survey, count: int) -> Choice:
    """Select the sharpest frame of each section of equal camera motion.

    Args:
        survey: Survey of all frames.
        count: Most frames; 0: one per 5 % of the picture's longer side, 30 to 300.
    """
    sharpness = relative_sharpness(survey)
    blurred = sharpness < _BLURRED
    usable = ~blurred & ~survey.repeated
    way = _way(survey, blurred)
    if count == 0:
        count = int(np.clip(round(way[-1] / SPACING), FEWEST, MOST))
    taken = _most_sections(way, sharpness, usable, count)
    return Choice(
        frames=taken,
        sharpness=sharpness,
        blurred=int((blurred & ~survey.repeated).sum()),
        repeated=int(survey.repeated.sum()),
        gaps=_gaps(survey, taken, blurred),
    )


def relative_sharpness(survey: Survey) -> np.ndarray:
    """[n]: detail as a share of that of sharp frames within three seconds.

    Detail is the variance of the Laplacian over the root of that at a quarter of the size: slight
    blur changes only the former, the content of the view both. If a long part is blurred
    completely, half of the video's usual detail counts as sharp.
    """
    detail = survey.fine / np.sqrt(survey.coarse + 1.0)
    usual = np.percentile(detail, _SHARP)
    first = np.searchsorted(survey.seconds, survey.seconds - _NEARBY, side="left")
    last = np.searchsorted(survey.seconds, survey.seconds + _NEARBY, side="right")
    sharp = np.array([np.percentile(detail[a:b], _SHARP) for a, b in zip(first, last, strict=True)])
    return detail / np.maximum(np.maximum(sharp, usual / 2), 1e-12)


def _way(survey: Survey, blurred: np.ndarray) -> np.ndarray:
    """[n]: camera motion, limited in blurred frames to its usual speed, because a shake moves far
    without useful frames, and would take sections away from useful parts."""
    steps = np.diff(survey.travel, prepend=survey.travel[0])
    sharp = ~blurred & ~survey.repeated
    usual = float(steps[sharp].mean()) if sharp.any() else 0.0
    return np.where(blurred, np.minimum(steps, usual), steps).cumsum()


def _most_sections(
    way: np.ndarray, sharpness: np.ndarray, usable: np.ndarray, count: int
) -> np.ndarray:
    """Frames of the largest number of sections that gives at most `count`; some have none."""
    best = _taken(way, sharpness, usable, count)
    low, high = count, max(4 * count, count + 1)
    while low + 1 < high and len(best) < count:
        middle = (low + high) // 2
        found = _taken(way, sharpness, usable, middle)
        if len(found) > count:
            high = middle
        else:
            low = middle
            best = found if len(found) > len(best) else best
    return best


def _taken(way: np.ndarray, sharpness: np.ndarray, usable: np.ndarray, sections: int) -> np.ndarray:
    length = way[-1] / sections
    if length <= 0:
        return np.flatnonzero(usable)[:1]
    place = way / length
    piece = np.minimum(place.astype(np.int64), sections - 1)
    worth = np.minimum(sharpness, 1.5) * (1 - _CENTRE * (2 * np.abs(place - piece - 0.5)) ** 2)
    taken: list[int] = []
    ends = np.searchsorted(piece, np.arange(sections + 1))
    for a, b in pairwise(ends):
        fits = usable[a:b].copy()
        if taken:
            fits &= place[a:b] - place[taken[-1]] >= _MIN_DISTANCE
        if fits.any():
            taken.append(int(a + np.where(fits, worth[a:b], -1.0).argmax()))
    return np.array(taken, np.int64)


def _gaps(survey: Survey, taken: np.ndarray, blurred: np.ndarray) -> list[tuple[float, float]]:
    """Parts between two selected frames with more than three times the median motion, and with
    blur."""
    if len(taken) < 3:
        return []
    ways = np.diff(survey.travel[taken])
    usual = np.median(ways)
    found = []
    for a, b, way in zip(taken, taken[1:], ways, strict=False):
        if way > 3 * usual and blurred[a:b].any():
            found.append((float(survey.seconds[a]), float(survey.seconds[b])))
    return found
