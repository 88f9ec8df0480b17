"""Load balance of a batch: photos of similar cost, since the slowest sets the time."""

from collections.abc import Mapping, Sequence

_BATCHES = 8
"""Batches, at most, whose photos are dealt out anew together, and no more than a third of an epoch:
chance decides which these are, so the same photos do not always meet."""


def batches_of_equal_cost(
    order: Sequence[int], costs: Mapping[int, float], size: int, *, first: int = 0
) -> list[int]:
    """The photos of an epoch, dealt out so that those of a batch cost alike.

    Some batches at a time, so that which photos meet, and when, stays a matter of chance.

    Args:
        order: The photos in the order in which chance has put them.
        costs: What each took when it was last seen; where one is not known, the order stays.
        size: Photos of a batch.
        first: How many go to a batch that is under way; these stay the first.
    """
    if any(photo not in costs for photo in order):
        return list(order)
    place = {photo: k for k, photo in enumerate(order)}
    dealt, rest = list(order[:first]), order[first:]
    width = size * max(1, min(_BATCHES, len(rest) // (3 * size)))
    for begin in range(0, len(rest), width):
        some = sorted(rest[begin : begin + width], key=costs.__getitem__)
        parts = (some[k : k + size] for k in range(0, len(some), size))
        batches = [sorted(part, key=place.__getitem__) for part in parts]
        whole = [batch for batch in batches if len(batch) == size]
        whole.sort(key=lambda batch: place[batch[0]])
        for batch in (*whole, *batches[len(whole) :]):
            dealt += batch
    return dealt
