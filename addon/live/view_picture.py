"""View picture: the splats of one view, drawn by the graphics card; for draw handlers."""

import time
from collections.abc import Callable

import gpu

from .card import Canvas, Card, Shot
from .uploads import Order


class ViewPicture:
    """Keeps what has been drawn as long as it stays the same: Blender draws views again and again,
    at each step of the mouse over a panel."""

    def __init__(self) -> None:
        self._canvas: Canvas | None = None
        self._holds: tuple[Order, Shot, gpu.types.GPUTexture | None] | None = None
        """What the canvas shows."""

    def draw(
        self,
        card: Card,
        atlas: gpu.types.GPUTexture,
        order: Order,
        shot: Shot,
        meshes: gpu.types.GPUTexture | None,
        *,
        nearness: bool = False,
        exact: bool = False,
        took: Callable[[float], None] | None = None,
    ) -> Canvas:
        """The picture.

        Args:
            card: What draws it.
            atlas: As `Card.draw`.
            order: Its entries name rows of the atlas.
            shot: From where.
            meshes: As `Card.draw`; another where depths differ (`Depths`).
            nearness: Whether the picture gets it.
            exact: As `Canvas`.
            took: Called with the seconds that the card needed, if it has to draw; waits for it.
        """
        size = shot.camera.width, shot.camera.height
        canvas = self._fitting(*size, nearness, exact)
        if canvas is not None and self._holds is not None:
            order_, shot_, meshes_ = self._holds
            if order_ is order and meshes_ is meshes and shot.same(shot_):
                return canvas
        self._holds = None  # until it is drawn
        if canvas is None:
            canvas = self._canvas = Canvas(*size, nearness=nearness, exact=exact)
        if took is None:
            card.draw(canvas, atlas, order, shot, meshes)
        else:
            _wait(canvas)
            began = time.perf_counter()
            card.draw(canvas, atlas, order, shot, meshes)
            _wait(canvas)
            took(time.perf_counter() - began)
        self._holds = order, shot, meshes
        return canvas

    def _fitting(self, width: int, height: int, nearness: bool, exact: bool) -> Canvas | None:
        """The canvas, if it is one of that kind."""
        canvas = self._canvas
        if canvas is None or (canvas.width, canvas.height) != (width, height):
            return None
        kind = canvas.nearness is not None, canvas.exact
        return canvas if kind == (nearness, exact) else None


def _wait(canvas: Canvas) -> None:
    """Until all is drawn that was asked for: a pixel is read."""
    with canvas.bind():
        gpu.state.active_framebuffer_get().read_color(0, 0, 1, 1, 4, 0, "FLOAT")
