"""Memory allocated by a thread; oracle: the sizes and values of the arrays."""

import gc
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from addon.process.reserved_memory import Memory


@pytest.fixture
def makers() -> Callable[[], list[threading.Thread]]:
    """The threads that allocate memory for this test."""
    others = set(threading.enumerate())
    return lambda: [
        t for t in threading.enumerate() if t.name == "gscore-memory" and t not in others
    ]


def test_arrays_come_in_order_and_are_zero(makers: Callable) -> None:
    """Also for empty arrays; the thread ends with the last."""
    memory = Memory([5, 0, 70_000])
    for size in (5, 0, 70_000):
        until = time.monotonic() + 60
        while not memory.ready:
            assert time.monotonic() < until
        array = memory.take()
        assert array.dtype == np.float32 and array.shape == (size,) and not array.any()
    assert not memory.ready
    for thread in makers():
        thread.join(60)
    assert not makers()


def test_no_more_is_made_for_nobody(makers: Callable) -> None:
    """Oracle: the thread ends long before it could have allocated 4 TB."""
    memory = Memory([1 << 20] * (1 << 20))
    del memory
    gc.collect()
    for thread in makers():
        thread.join(60)
    assert not makers()


def test_allocation_failure_raises_at_the_owner() -> None:
    """Oracle: numpy's error when the array is taken; later arrays are allocated."""
    memory = Memory([1 << 60, 3])
    until = time.monotonic() + 60
    while not memory.ready:
        assert time.monotonic() < until
    with pytest.raises(MemoryError):
        memory.take()
    while not memory.ready:
        assert time.monotonic() < until
    assert memory.take().shape == (3,)
