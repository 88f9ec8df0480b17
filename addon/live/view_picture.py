"""View picture: the splats of one view, drawn by the graphics card; for draw handlers."""

import time
from collections.abc import Callable

import gpu

from .card import Canvas, Card, Shot
from .texture_upload import Order


class ViewPicture:
    """Keeps the drawn picture until it changes, because Blender redraws views often, for example
    at each mouse move over a panel."""

    def __init__(self) -> None:
        self._canvas: Canvas | None = None
        self._holds: tuple[Order, Shot, gpu.types.GPUTexture | None] | None = None
        """Content of the canvas."""

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
        """The picture, drawn only if anything has changed.

        Args:
            card: The graphics card.
            atlas: As for `Card.draw`.
            order: Order of rows of the atlas.
            shot: Camera and settings.
            meshes: As for `Card.draw`; compared by identity (`Depths`).
            nearness: As for `Canvas`.
            exact: As for `Canvas`.
            took: Called with the seconds that the card needed to draw, which means waiting for it.
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
        """The canvas, if it has this size and kind."""
        canvas = self._canvas
        if canvas is None or (canvas.width, canvas.height) != (width, height):
            return None
        kind = canvas.nearness is not None, canvas.exact
        return canvas if kind == (nearness, exact) else None


def _wait(canvas: Canvas) -> None:
    """Wait until the card has finished drawing, by reading a pixel."""
    with canvas.bind():
        gpu.state.active_framebuffer_get().read_color(0, 0, 1, 1, 4, 0, "FLOAT")
