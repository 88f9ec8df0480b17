"""Compilation of the card's programs over several redraws."""

from types import SimpleNamespace

import gpu
import pytest

from addon.live import draw_handler
from tests.addon.live import graphics


class SlowCard:
    """A card with five programs, each of which takes 40 ms of a clock."""

    def __init__(self) -> None:
        self.compiled, self.now = 0, 100.0

    @property
    def ready(self) -> bool:
        """Whether all are compiled."""
        return self.compiled == 5

    def step(self) -> bool:
        """Compile one."""
        self.compiled, self.now = self.compiled + 1, self.now + 0.04
        return self.ready


@pytest.mark.parametrize(("spare", "counts"), [(0.0, [1, 2, 3, 4, 5]), (0.1, [3, 5])])
def test_each_redraw_compiles_a_program(
    monkeypatch: pytest.MonkeyPatch, spare: float, counts: list[int]
) -> None:
    """Oracle: one program per redraw; where redraws are slow, what fits in the spare time and the
    last one begun in it."""
    card = SlowCard()
    monkeypatch.setattr(draw_handler._state, "card", card)
    monkeypatch.setattr(draw_handler._state.pace, "spare", spare)
    monkeypatch.setattr(draw_handler, "time", SimpleNamespace(perf_counter=lambda: card.now))
    for count in counts:
        assert draw_handler._compiled() == (count == 5)
        assert card.compiled == count


@pytest.mark.graphics
def test_a_step_compiles_one_program(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the calls of Blender's compiler: none before the first step, then one each."""
    graphics.begin()
    from addon.live.card import Card

    made, real = [], gpu.shader.create_from_info
    monkeypatch.setattr(gpu.shader, "create_from_info", lambda i: made.append(i) or real(i))
    card = Card()
    assert not made
    steps = 0
    while not card.ready:
        assert card.step() == card.ready
        steps += 1
        assert len(made) == steps
    assert steps == (5 if card.nears else 3)
    assert card.step() and len(made) == steps
