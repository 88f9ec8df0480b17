"""Batch size: photos per step with several processes."""

from collections.abc import Iterable


def batch_size(
    size: int, taken: int, *, every: Iterable[int], marks: Iterable[int], end: int
) -> int:
    """Return the number of photos of the next step: `size`, or less up to the next event.

    Events so occur after the same number of photos for any number of processes.

    Args:
        size: Size of a full batch, at least 1.
        taken: Photos before this step.
        every: Periods of recurring events, in photos; those below 1 are ignored.
        marks: Numbers of photos after which single events occur.
        end: Number of photos of the run.
    """
    left = [number - taken % number for number in every if number >= 1]
    left += [mark - taken for mark in (*marks, end) if mark > taken]
    return min([size, *left])
