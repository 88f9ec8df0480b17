"""Equality of values with arrays; oracle: `==` of plain values, element by element."""

from dataclasses import dataclass, field

import numpy as np

from addon.equality import same


@dataclass(frozen=True)
class _Pair:
    array: np.ndarray
    name: str = ""
    note: str = field(default="", compare=False)


@dataclass(eq=False)
class _Own:
    number: int = 1


def test_values_with_arrays_are_compared_by_content() -> None:
    """Oracle: what each pair of values contains."""
    one, copy = np.arange(3.0), np.arange(3.0)
    assert same(one, copy) and not same(one, copy + 1) and not same(one, copy[:2])
    assert same((one, "a"), (copy, "a")) and not same((one,), (copy, copy))
    assert same([np.array([np.nan, 1])], [np.array([np.nan, 1])])
    assert not same(1, 1.0) and not same((1,), [1])


def test_dataclasses_are_compared_by_their_compared_fields() -> None:
    """Oracle: the declarations above; those with `eq=False` are equal to themselves alone."""
    assert same(_Pair(np.ones(2), note="x"), _Pair(np.ones(2), note="y"))
    assert not same(_Pair(np.ones(2), "a"), _Pair(np.ones(2), "b"))
    own = _Own()
    assert same(own, own) and not same(own, _Own())
