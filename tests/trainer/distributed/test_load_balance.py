"""Photos of a batch with similar costs; oracle: the costs themselves, and counting."""

import random

import pytest

from gscore.trainer.step.training_views import batches_of_equal_cost

MORE = {photo: (photo * 31 % 97) + 50.0 for photo in range(52, 60)}
COSTS = {photo: (photo * 7919 % 101) + 50.0 for photo in range(52)}


def apart(order: list[int], size: int, first: int = 0) -> float:
    """Waiting time of batches: the slowest photo minus the mean, summed."""
    batches = (order[k : k + size] for k in range(first, len(order), size))
    return sum(max(COSTS[p] for p in b) - sum(COSTS[p] for p in b) / len(b) for b in batches)


def test_all_photos_come_once_and_alike_ones_together() -> None:
    """Oracle: the same photos, and less than a third of the waiting of a random order."""
    for size, first in ((2, 0), (2, 1), (4, 3)):
        order = random.Random(size + first).sample(range(52), 52)
        dealt = batches_of_equal_cost(order, COSTS, size, first=first)
        assert sorted(dealt) == list(range(52))
        assert dealt[:first] == order[:first]
        assert apart(dealt, size, first) < apart(order, size, first) / 3


def test_chance_decides_who_meets_and_who_is_first() -> None:
    """Oracle: many partners of each photo over many epochs, and the slower photo on either rank."""
    chance, partners, slower = random.Random(0), set(), [0, 0]
    for _ in range(30):
        dealt = batches_of_equal_cost(chance.sample(range(52), 52), COSTS, 2)
        for a, b in pairs(dealt):
            partners |= {(a, b), (b, a)}
            slower[COSTS[b] > COSTS[a]] += 1
    assert sum(1 for a, _ in partners if a == 7) > 5
    assert min(slower) > 0.4 * sum(slower)


@pytest.mark.parametrize(("photos", "size"), [(16, 2), (32, 4), (59, 8)])
def test_few_photos_meet_others_each_time(photos: int, size: int) -> None:
    """Oracle: mostly different batches over many epochs."""
    chance, seen, count = random.Random(1), set(), 0
    for _ in range(40):
        dealt = batches_of_equal_cost(chance.sample(range(photos), photos), COSTS | MORE, size)
        for begin in range(0, photos, size):
            seen.add(frozenset(dealt[begin : begin + size]))
            count += 1
    assert len(seen) > (0.25 if size == 2 else 0.8) * count


def pairs(order: list[int]) -> list[tuple[int, int]]:
    """The photos two by two."""
    return list(zip(order[::2], order[1::2], strict=True))


def test_an_order_without_costs_stays() -> None:
    """Oracle: the order."""
    order = [3, 1, 2, 0]
    assert batches_of_equal_cost(order, {0: 1.0, 1: 2.0, 2: 3.0}, 2) == order
