"""Training photos that fit far worse than the others; oracle: errors by design."""

import math

from gscore.trainer.step.photo_errors import PhotoErrors

NAMES = [f"{i:02}.jpg" for i in range(30)]
TRAIN = list(range(0, 30, 2))
STEPS = 150


def errors_of(worse: dict[int, float], count: int = len(TRAIN)) -> str:
    """The sentence after a step of each training photo, at 27 to 28 dB but those of `worse`."""
    errors = PhotoErrors()
    for place, index in enumerate(TRAIN[:count]):
        errors.note([index], 1.0)  # replaced by the next
        errors.note([index], 10 ** (-worse.get(index, 27 + place / count) / 10))
        errors.note([index, 3], 1.0)  # of two photos together
        errors.note([index], math.nan)
    return errors.outliers(NAMES, TRAIN[:count], STEPS)


def test_photos_that_fit_far_worse_are_named() -> None:
    """Oracle: one photo at 15 dB, below a median of 27.5."""
    said = errors_of({8: 15.0})
    assert said.startswith("1 training photo fits far worse than the others, whose median is 27.")
    assert "08.jpg (15.0 dB)." in said and "symmetric" not in said
    several = errors_of(dict.fromkeys(TRAIN[1::4], 12.0))
    assert several.startswith("4 training photos fit far worse") and "symmetric" in several


def test_photos_that_fit_alike_are_not_named() -> None:
    """Oracle: a slightly worse photo; as many bad ones as good ones; too few photos or steps; and
    one that was in no step since a resume."""
    assert errors_of({}) == errors_of({8: 25.0}) == errors_of({8: 15.0}, count=8) == ""
    assert errors_of(dict.fromkeys(TRAIN[::3], 15.0)) == ""
    errors = PhotoErrors()
    for index in TRAIN[1:]:
        errors.note([index], 0.002 if index > 2 else 0.5)
    assert errors.outliers(NAMES, TRAIN, STEPS) == ""
    errors.note([TRAIN[0]], 0.002)
    assert "02.jpg" in errors.outliers(NAMES, TRAIN, STEPS)
    assert errors.outliers(NAMES, TRAIN, STEPS - 1) == ""
