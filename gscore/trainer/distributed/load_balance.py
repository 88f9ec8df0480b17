"""Load balance of a batch: photos of similar cost, since the slowest sets the time."""

from collections.abc import Mapping, Sequence

_BATCHES = 8
"""Most batches that are sorted together, at most a third of an epoch: their photos are random, so
that the same photos do not always share a batch."""


def batches_of_equal_cost(
    order: Sequence[int], costs: Mapping[int, float], size: int, *, first: int = 0
) -> list[int]:
    """Reorder the photos of an epoch so that those of a batch have similar costs.

    Sorts a few batches at a time, so that the composition and order of batches stay random.

    Args:
        order: Photos in random order.
        costs: Last rendering cost of each photo; if one is missing, the order stays.
        size: Photos of a batch.
        first: Number of photos that complete the current batch; they stay first.
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
