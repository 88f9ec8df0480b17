"""Drawing of live views, in Blenders with graphics without a window. Oracles: in the tests."""

import time
from collections.abc import Iterator
from dataclasses import replace

import bpy
import numpy as np
import pytest

from addon.cameras.render_camera import RenderCamera
from addon.live.level import STILL
from addon.render.model import SplatCache
from addon.render.scene import Placed, place, sources
from addon.render.selections import Tinted
from addon.splats.filters import Filters
from tests.addon import splat_scenes as lab
from tests.addon.live import graphics

pytestmark = pytest.mark.graphics

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
    """Splats with an even scale."""
    lab.add(scene, lab.blob(800), "chair")
    bpy.context.view_layer.update()
    (source,) = sources(bpy.context.evaluated_depsgraph_get())
    return place(source)


def stretched(placed: Placed) -> Placed:
    """The same, scaled along one axis."""
    return replace(placed, matrix=placed.matrix @ np.diag([1.0, 2.0, 1.0, 1.0]))


class Screen:
    """A view and its card."""

    def __init__(self) -> None:
        graphics.begin()
        from addon.live.card import Card
        from addon.live.views import View

        self.card, self.view = Card(), View(SplatCache())
        while not self.card.step():
            pass

    def draw(self, one: Placed) -> object:
        """A redraw."""
        from addon.live.clip import Cuts

        given = (self.card, [one], CAMERA, WINDOW, "AUTO", None)
        return self.view.draw(*given, front=False, cuts=Cuts(), tinted=Tinted.NONE)

    def drawn(self, one: Placed) -> object:
        """Redraw until the picture is complete."""
        until = time.monotonic() + 60
        while (picture := self.draw(one)) is None or not self.view.complete:
            assert time.monotonic() < until
            time.sleep(0.02)
        return picture


@pytest.fixture
def screen() -> Iterator[Screen]:
    """A new screen."""
    made = Screen()
    yield made
    made.view.close()


def test_a_known_object_is_refused_at_once(screen: Screen, placed: Placed) -> None:
    """Oracle: the engine's error about an uneven scale, in the same redraw; the view requests
    nothing meanwhile; with an even scale again it is drawn."""
    with pytest.raises(ValueError, match=r"chair cannot be rendered.*unevenly") as wanted:
        SplatCache().model([stretched(placed)])
    view = screen.view
    assert screen.drawn(placed) is not None
    with pytest.raises(ValueError) as got:
        screen.draw(stretched(placed))
    assert str(got.value) == str(wanted.value) and not view.complete
    time.sleep(0.3)  # the view comes to rest
    with pytest.raises(ValueError):
        screen.draw(stretched(placed))
    assert not (view.waits or view.stale(time.monotonic()))
    assert screen.drawn(placed) is not None


def test_a_filter_that_is_dragged_is_like_a_turn(screen: Screen, placed: Placed) -> None:
    """Oracle: the view counts as moving with each new limit, and as still a while later."""
    view = screen.view
    screen.drawn(placed)
    assert not view.level.moving
    for limit in (0.2, 0.4):
        screen.draw(replace(placed, filters=Filters(opacity_min=limit)))
        assert view.level.moving and view.waits
    screen.draw(last := replace(placed, filters=Filters(opacity_min=0.4)))
    time.sleep(STILL)
    screen.drawn(last)
    assert not (view.level.moving or view.waits)
