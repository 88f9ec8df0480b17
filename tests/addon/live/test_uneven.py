"""A view whose splats are scaled unevenly, in Blenders with graphics without a window. Oracle: what
the engine says of them."""

import time
from dataclasses import replace

import bpy
import numpy as np
import pytest

from addon.cameras.render_camera import RenderCamera
from addon.render.model import SplatCache
from addon.render.scene import Placed, place, sources
from addon.render.selections import Tinted
from tests.addon import splat_scenes as lab
from tests.addon.live import graphics

WINDOW = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1.002, -0.2002], [0, 0, -1, 0]])
CAMERA = RenderCamera(
    viewmat=np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]),
    K=np.array([[80.0, 0, 48], [0, 80, 32], [0, 0, 1]]),
    width=96,
    height=64,
    near=0.1,
    orthographic=False,
    name="view",
)


@pytest.fixture
def placed(scene: bpy.types.Scene) -> Placed:
    """Splats that stand evenly."""
    lab.add(scene, lab.blob(800), "chair")
    bpy.context.view_layer.update()
    (source,) = sources(bpy.context.evaluated_depsgraph_get())
    return place(source)


def stretched(placed: Placed) -> Placed:
    """The same, scaled along one axis."""
    return replace(placed, matrix=placed.matrix @ np.diag([1.0, 2.0, 1.0, 1.0]))


def test_a_known_object_is_refused_at_once(placed: Placed) -> None:
    """Oracle: the sentence of the engine, in the very redraw; nothing further is asked of the view
    meanwhile; evenly again it is drawn."""
    graphics.begin()
    from addon.live.card import Card
    from addon.live.clip import Cuts
    from addon.live.views import View

    card = Card()

    def draw(view: View, one: Placed) -> object:
        return view.draw(
            card, [one], CAMERA, WINDOW, "AUTO", None, front=False, cuts=Cuts(), tinted=Tinted.NONE
        )

    def drawn(view: View, one: Placed) -> object:
        until = time.monotonic() + 20
        while (picture := draw(view, one)) is None or not view.complete:
            assert time.monotonic() < until
            time.sleep(0.02)
        return picture

    with pytest.raises(ValueError, match=r"chair cannot be rendered.*unevenly") as wanted:
        SplatCache().model([stretched(placed)])
    known = View(SplatCache())
    assert drawn(known, placed) is not None
    with pytest.raises(ValueError) as got:
        draw(known, stretched(placed))
    assert str(got.value) == str(wanted.value) and not known.complete
    time.sleep(0.3)  # the view comes to rest
    with pytest.raises(ValueError):
        draw(known, stretched(placed))
    assert not (known.waits or known.stale(time.monotonic()))
    assert drawn(known, placed) is not None
    known.close()
