"""Orders of painted splats by a view's thread. Oracle: the result of a new thread without a
cache."""

from collections.abc import Callable
from dataclasses import replace

import bpy
import numpy as np
import pytest

from addon.live import atlas, order, views
from addon.render.mesh_copies import HIDDEN, SELECTED, FrozenMesh, freeze
from addon.render.model import SplatCache
from addon.render.scene import Placed, place, sources
from addon.render.selections import Tinted
from tests.addon import splat_scenes as lab

EYE = order.Eye(viewmats=(np.diag([1.0, -1, -1, 1]),), orthographic=False)


@pytest.fixture
def draw_request(scene: bpy.types.Scene) -> Callable[[FrozenMesh], views.DrawRequest]:
    """A request for an object with one of its copies."""
    ob = lab.add(scene, lab.blob(800))
    bpy.context.view_layer.update()
    (source,) = sources(bpy.context.evaluated_depsgraph_get())

    def make(frozen: FrozenMesh) -> views.DrawRequest:
        placed: Placed = place(source, frozen)
        return views.DrawRequest(placed=(placed,), eye=EYE, count=800, tinted=Tinted.ALL)

    make.frozen = freeze(ob.data, ob.name)
    return make


def seen(answer: tuple[atlas.Atlas, np.ndarray]) -> np.ndarray:
    """Visible splats by index, [M, 5]: colours, opacity and index."""
    made, entries = answer
    rows = entries[:, 0].astype(int)
    texels = made.texels.reshape(-1, atlas.TEXELS, 4)[rows, 0, 3]
    table = np.column_stack([made.index[rows], entries[:, 1:], texels])
    return table[np.argsort(table[:, 0])]


def test_paint_and_selections_go_over_what_they_change(draw_request, monkeypatch) -> None:
    """Oracle: a new view, to the bit; nothing was sorted again."""
    arranger = views.Arranger(SplatCache())
    frozen = draw_request.frozen
    first = seen(arranger(draw_request(frozen)))
    sorted_ = []
    arrange = order.arrange
    monkeypatch.setattr(order, "arrange", lambda *a: sorted_.append(1) or arrange(*a))
    base = frozen.base.copy()
    base[100:300] = np.random.default_rng(3).uniform(0, 1, (200, 4))
    marks = np.zeros(800, np.uint8)
    marks[200:500] = SELECTED
    steps = [frozen.repainted(base), frozen.repainted(base).remarked(marks), frozen]
    for step in steps:
        got = seen(arranger(draw_request(step)))
        assert not sorted_
        want = seen(views.Arranger(SplatCache())(draw_request(step)))
        sorted_.clear()
        np.testing.assert_array_equal(got, want)
    np.testing.assert_array_equal(got, first)


def test_new_view_or_hidden_splats_are_sorted_again(draw_request, monkeypatch) -> None:
    """Oracle: a new view, and the number of sorts."""
    arranger, frozen, calls = views.Arranger(SplatCache()), draw_request.frozen, []
    arrange = order.arrange
    monkeypatch.setattr(order, "arrange", lambda *a: calls.append(1) or arrange(*a))
    arranger(draw_request(frozen))
    hidden = np.where(np.arange(800) < 50, HIDDEN, 0).astype(np.uint8)
    asked = draw_request(frozen.remarked(hidden))
    # In Edit Mode, where hidden splats are not drawn.
    asked = replace(asked, placed=(replace(asked.placed[0], edited=True),))
    assert len(arranger(asked)[1]) == 750 and len(calls) == 2
    assert len(arranger(replace(asked, count=300))[1]) <= 300 and len(calls) == 3
