"""Colours and opacities that change before Blender's mesh does. Oracles: the given values, and a
new decoding of everything."""

import weakref
from collections.abc import Iterator
from dataclasses import replace

import bpy
import numpy as np
import pytest

from addon import attributes
from addon.attributes import BASE
from addon.core import Splats
from addon.render import viewport_copies
from addon.render.mesh_copies import freeze, repainted_rows, trace_of
from addon.render.model import SplatCache
from addon.render.scene import Placed, place, sources
from tests.addon import splat_scenes as lab

FIELDS = ("means", "quats", "scales", "opacities", "sh0", "shN")


@pytest.fixture
def ob(scene: bpy.types.Scene) -> bpy.types.Object:
    """200 splats, one of them a vertex added by hand, with scale 0."""
    made = lab.add(scene, lab.blob(200))
    made.data.attributes[attributes.SCALE].data[7].vector = (0, 0, 0)
    bpy.context.view_layer.update()
    return made


@pytest.fixture
def made() -> Iterator[viewport_copies.Copies]:
    """Copies that receive depsgraph updates."""
    one = viewport_copies.Copies()

    def changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
        one.forget_changed(depsgraph)

    bpy.app.handlers.depsgraph_update_post.append(changed)
    yield one
    bpy.app.handlers.depsgraph_update_post.remove(changed)


def painted(ob: bpy.types.Object, rows: np.ndarray) -> np.ndarray:
    """[N, 4] of `radiance:base` with other values in some rows."""
    base = attributes.column(ob.data, BASE)
    base[rows] = np.random.default_rng(1).uniform(0, 1, (len(rows), 4))
    base[rows[0], 3] = 0.0
    return base


def look(made: viewport_copies.Copies) -> Placed:
    """The placed object of a redraw."""
    (found,), _ = made.copied(sources(bpy.context.evaluated_depsgraph_get()))
    return found


def same(one: Splats, other: Splats) -> None:
    """All arrays to the bit."""
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(one, field), getattr(other, field), field)


def test_paint_shows_before_and_after_it_is_written(ob, made) -> None:
    """Oracle: the given values; once written, the mesh, with nothing left to do."""
    while not made.copied(sources(bpy.context.evaluated_depsgraph_get()))[1]:
        pass
    before = look(made).frozen
    base = painted(ob, np.arange(3, 60))
    made.repaint(ob.data.session_uid, base.copy())
    shown = look(made).frozen
    np.testing.assert_array_equal(shown.base, base)
    assert shown.columns[attributes.POSITION] is before.columns[attributes.POSITION]
    assert (before.base != base).any()
    attributes.fill(ob.data, BASE, "FLOAT_COLOR", base.ravel())
    ob.data.update()
    bpy.context.view_layer.update()
    np.testing.assert_array_equal(look(made).frozen.base, base)
    while not made.copied(sources(bpy.context.evaluated_depsgraph_get()))[1]:
        pass
    assert look(made).frozen is not shown
    assert look(made).frozen.fingerprint == shown.fingerprint


def test_a_copy_under_way_takes_the_paint(ob, made, monkeypatch) -> None:
    """Oracle: the values given after the first attributes were copied."""
    monkeypatch.setattr(viewport_copies, "COPY_BUDGET", 0.0)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for _ in range(3):  # by name: position and the constant colour are copied
        made.copied(sources(depsgraph))
    base = painted(ob, np.arange(50))
    made.repaint(ob.data.session_uid, base.copy())
    while not made.copied(sources(depsgraph))[1]:
        pass
    np.testing.assert_array_equal(look(made).frozen.base, base)


def test_paint_of_another_number_of_splats_is_left_out(ob, made) -> None:
    """Oracle: the mesh."""
    while not made.copied(sources(bpy.context.evaluated_depsgraph_get()))[1]:
        pass
    made.repaint(ob.data.session_uid, np.zeros((199, 4), np.float32))
    want = attributes.column(ob.data, BASE)
    np.testing.assert_array_equal(look(made).frozen.base, want)


@pytest.mark.parametrize("opacity_min", [0.0, 0.5])
def test_only_what_was_painted_is_decoded(ob, opacity_min: float) -> None:
    """Oracle: a decoding of all, to the bit; also where paint makes others pass the filter."""
    ob.gscore.opacity_min = opacity_min
    bpy.context.view_layer.update()
    (source,) = sources(bpy.context.evaluated_depsgraph_get())
    frozen, cache = freeze(ob.data, ob.name), SplatCache()
    cache.parts([place(source, frozen)])
    rows = np.array([3, 7, 50, 51, 120])
    base = frozen.base.copy()
    base[rows, :3] += 0.5
    for opacities in (None, 0.3 * base[rows, 3]):
        if opacities is not None:
            base[rows, 3] = opacities
        painted_ = place(source, frozen.repainted(base.copy()))
        (got,) = cache.parts([painted_])
        (want,) = SplatCache().parts([painted_])
        same(got, want)
        assert len(got) == (200 if not opacity_min else (base[:, 3] >= 0.5).sum())
    assert cache.decoded == (1 if not opacity_min else 2)


def test_only_paint_is_remembered_of_a_copy(ob) -> None:
    """Oracle: the arrays of copies that stay alive without other references; and a decoding of
    all."""
    (source,) = sources(bpy.context.evaluated_depsgraph_get())
    frozen, cache = freeze(ob.data, ob.name), SplatCache()
    first = frozen.repainted(painted(ob, np.arange(3, 60)))
    second = frozen.repainted(painted(ob, np.arange(90, 150)))
    arrays = [weakref.ref(values) for one, values in first.columns.items() if one != BASE]
    cache.parts([place(source, first)])
    (got,) = cache.parts([place(source, second)])
    same(got, second.read())
    assert cache.decoded == 1 and len(arrays) >= 3
    del frozen, first, second
    assert [array() for array in arrays] == [None] * len(arrays)


def test_changed_rows_of_copies(ob) -> None:
    """Oracle: the changed rows; None if more has changed, or values are not finite."""
    one = freeze(ob.data, "one")
    base = one.base.copy()
    assert repainted_rows(trace_of(one), one.repainted(base.copy())).tolist() == []
    base[[4, 9], 1] = 2
    assert repainted_rows(trace_of(one), one.repainted(base.copy())).tolist() == [4, 9]
    base[4, 1] = np.nan
    assert repainted_rows(trace_of(one), one.repainted(base.copy())) is None
    ob.data.attributes[attributes.SCALE].data[0].vector = (1, 1, 1)
    assert repainted_rows(trace_of(one), freeze(ob.data, "one")) is None
    assert repainted_rows(trace_of(one), replace(one, sums={})) is None


def test_selections_show_before_they_are_written(ob, made) -> None:
    """Oracle: the given marks."""
    while not made.copied(sources(bpy.context.evaluated_depsgraph_get()))[1]:
        pass
    marks = (np.arange(200) % 2).astype(np.uint8)
    made.remark(ob.data.session_uid, marks)
    np.testing.assert_array_equal(look(made).frozen.marks, marks)
