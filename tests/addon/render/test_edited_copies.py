"""Copies of splats in Edit Mode, where Blender reports each copy as a change."""

import time
from collections.abc import Iterator

import bmesh
import bpy
import numpy as np
import pytest

from addon.render import viewport_copies
from addon.render.scene import Source, sources
from tests.addon import splat_scenes as lab

COUNT = 300


class Views:
    """Fake views: they copy at each redraw, and receive updates."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.made, self.copied = viewport_copies.Copies(), 0
        frozen = Source.frozen_mesh

        def counted(source: Source) -> object:
            self.copied += 1
            return frozen(source)

        monkeypatch.setattr(Source, "frozen_mesh", counted)

    def told(self, scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
        """Pass updates to two listeners, as in a window."""
        self.made.forget_changed(depsgraph)
        self.made.forget_changed(depsgraph)

    def drawn(self) -> float:
        """Redraw; return the first splat's x."""
        found = sources(bpy.context.evaluated_depsgraph_get())
        placed, _ = self.made.copied(found)
        bpy.context.view_layer.update()
        return float(placed[0].frozen.attributes["position"].data.values[0])


@pytest.fixture
def views(scene: bpy.types.Scene, monkeypatch: pytest.MonkeyPatch) -> Iterator[Views]:
    """Views of one object in Edit Mode."""
    made, ob = Views(monkeypatch), lab.add(scene, lab.blob(COUNT))
    bpy.context.view_layer.objects.active = ob
    bpy.app.handlers.depsgraph_update_post.append(made.told)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.context.view_layer.update()
    yield made
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.app.handlers.depsgraph_update_post.remove(made.told)


def move(x: float) -> None:
    """Move the first splat, as a user does."""
    mesh = bpy.context.object.data
    editor = bmesh.from_edit_mesh(mesh)
    editor.verts.ensure_lookup_table()
    editor.verts[0].co.x = x
    bmesh.update_edit_mesh(mesh)


def test_a_view_comes_to_rest_in_edit_mode(views: Views) -> None:
    """Oracle: the number of copies, which ends; each edit is shown by the next redraw."""
    for x in (3.0, 4.0, 5.0):
        move(x)
        bpy.context.view_layer.update()
        assert views.drawn() == np.float32(x)
    for _ in range(5):
        views.drawn()
    before = views.copied
    for _ in range(20):
        assert views.drawn() == np.float32(5.0)
    assert views.copied == before


def test_an_edit_that_comes_with_an_echo_shows_when_it_rests(
    views: Views, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: Blender's position, although its update was taken for that of the copy."""
    monkeypatch.setattr(viewport_copies, "_REST", 0.05)
    move(6.0)
    bpy.context.view_layer.update()
    views.drawn()  # differs from the copy before, so the next update counts
    views.made.copied(sources(bpy.context.evaluated_depsgraph_get()))  # the same as that
    move(7.0)
    bpy.context.view_layer.update()
    assert views.drawn() == np.float32(6.0)
    time.sleep(0.1)
    assert views.drawn() == np.float32(7.0)
    for _ in range(5):
        views.drawn()
    before = views.copied
    time.sleep(0.1)
    for _ in range(20):
        views.drawn()
    assert views.copied <= before + 1


def test_slow_redraws_come_to_rest_too(views: Views, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the number of copies, which ends although every echo is late at first."""
    monkeypatch.setattr(viewport_copies, "_ECHO", 1e-9)
    monkeypatch.setattr(
        viewport_copies, "_REST", 1e9
    )  # a slow machine may rest in between otherwise
    views.made = viewport_copies.Copies()
    move(8.0)
    bpy.context.view_layer.update()
    for _ in range(8):
        views.drawn()
    before = views.copied
    for _ in range(20):
        assert views.drawn() == np.float32(8.0)
    assert views.copied == before
    # No user edits sooner, and fast redraws are finished by then.
    time.sleep(4 * viewport_copies._SAME_UPDATE)
    move(9.0)
    bpy.context.view_layer.update()
    views.drawn()
    assert views.drawn() == np.float32(9.0)
