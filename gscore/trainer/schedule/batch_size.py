"""Batch size: photos per step, where several processes train together."""

from collections.abc import Iterable


def batch_size(
    size: int, taken: int, *, every: Iterable[int], marks: Iterable[int], end: int
) -> int:
    """Photos of the next step: `size`, or as many as are left until something is due.

    So what is due after some photos is due after as many of them for any number of processes.

    Args:
        size: Of a full batch, at least 1.
        taken: Photos before.
        every: Numbers at whose multiples something is due; those below 1 are none.
        marks: Numbers after which something is due.
        end: After which the run ends.
    """
    left = [number - taken % number for number in every if number >= 1]
    left += [mark - taken for mark in (*marks, end) if mark > taken]
    return min([size, *left])
