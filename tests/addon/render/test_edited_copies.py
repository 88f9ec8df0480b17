"""Copies of splats in Edit Mode, where Blender reports each copy as a change."""

from collections.abc import Iterator
from types import SimpleNamespace

import bmesh
import bpy
import numpy as np
import pytest

from addon.render import viewport_copies
from addon.render.scene import Source, sources
from tests.addon import splat_scenes as lab

COUNT = 300


class Views:
    """Fake views: they copy at each redraw, and receive updates, on a clock of their own."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.made, self.copied, self.now = viewport_copies.Copies(), 0, 100.0
        clock = SimpleNamespace(perf_counter=lambda: self.now)
        monkeypatch.setattr(viewport_copies, "time", clock)
        frozen = Source.frozen_mesh

        def counted(source: Source) -> object:
            self.copied += 1
            return frozen(source)

        monkeypatch.setattr(Source, "frozen_mesh", counted)

    def reported(self, scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
        """Pass updates to two listeners, as in a window."""
        self.made.forget_changed(depsgraph)
        self.made.forget_changed(depsgraph)

    def drawn(self) -> float:
        """Redraw; return the first splat's x."""
        found = sources(bpy.context.evaluated_depsgraph_get())
        placed, _ = self.made.copied(found)
        self.now += 0.001
        bpy.context.view_layer.update()
        return float(placed[0].frozen.columns["position"][0, 0])

    def move(self, x: float) -> None:
        """Move the first splat, as a user does, a while after the last redraw."""
        self.now += 0.1
        mesh = bpy.context.object.data
        editor = bmesh.from_edit_mesh(mesh)
        editor.verts.ensure_lookup_table()
        editor.verts[0].co.x = x
        bmesh.update_edit_mesh(mesh)
        bpy.context.view_layer.update()


@pytest.fixture
def views(scene: bpy.types.Scene, monkeypatch: pytest.MonkeyPatch) -> Iterator[Views]:
    """Views of one object in Edit Mode."""
    made, ob = Views(monkeypatch), lab.add(scene, lab.blob(COUNT))
    bpy.context.view_layer.objects.active = ob
    bpy.app.handlers.depsgraph_update_post.append(made.reported)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.context.view_layer.update()
    yield made
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.app.handlers.depsgraph_update_post.remove(made.reported)


def test_a_view_comes_to_rest_in_edit_mode(views: Views) -> None:
    """Oracle: the number of copies, which ends; each edit is shown by the next redraw."""
    for x in (3.0, 4.0, 5.0):
        views.move(x)
        assert views.drawn() == np.float32(x)
    for _ in range(5):
        views.drawn()
    before = views.copied
    for _ in range(20):
        assert views.drawn() == np.float32(5.0)
    assert views.copied == before


def test_an_edit_that_comes_with_an_echo_shows_when_it_rests(
    views: Views,
) -> None:
    """Oracle: Blender's position, although its update was taken for that of the copy."""
    views.move(6.0)
    views.drawn()  # differs from the copy before, so the next update counts
    views.made.copied(sources(bpy.context.evaluated_depsgraph_get()))  # the same as that
    views.move(7.0)
    assert views.drawn() == np.float32(6.0)
    views.now += viewport_copies._REST
    assert views.drawn() == np.float32(7.0)
    for _ in range(5):
        views.drawn()
    before = views.copied
    views.now += viewport_copies._REST
    for _ in range(20):
        views.drawn()
    assert views.copied <= before + 1


def test_slow_redraws_come_to_rest_too(views: Views, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the number of copies, which ends although every echo is late at first."""
    monkeypatch.setattr(viewport_copies, "_ECHO", 1e-9)
    views.made = viewport_copies.Copies()
    views.move(8.0)
    for _ in range(8):
        views.drawn()
    before = views.copied
    for _ in range(20):
        assert views.drawn() == np.float32(8.0)
    assert views.copied == before
    views.move(9.0)
    views.drawn()
    assert views.drawn() == np.float32(9.0)
