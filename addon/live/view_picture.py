"""The picture of one view on the graphics card; used where Blender draws."""

import time
from collections.abc import Callable

import gpu

from .card import Card, Shot
from .uploads import Order


class ViewPicture:
    """Keeps what has been drawn as long as it stays the same: Blender draws views again and again,
    at each step of the mouse over a panel."""

    def __init__(self) -> None:
        self._target: gpu.types.GPUOffScreen | None = None
        self._holds: tuple[Order, Shot] | None = None
        """What the target shows; None where meshes, which may have moved, hide some of it."""

    def draw(
        self,
        card: Card,
        atlas: gpu.types.GPUTexture,
        order: Order,
        shot: Shot,
        meshes: gpu.types.GPUTexture | None,
        took: Callable[[float], None] | None = None,
    ) -> gpu.types.GPUTexture:
        """The picture, premultiplied sRGB values, the bottom row first.

        Args:
            card: What draws it.
            atlas: As `Card.draw`.
            order: Its entries name rows of the atlas.
            shot: From where.
            meshes: As `Card.draw`.
            took: Called with the seconds that the card needed, if it has to draw; waits for it.
        """
        if self._target is not None and meshes is None and self._holds is not None:
            order_, shot_ = self._holds
            if order_ is order and shot.same(shot_):
                return self._target.texture_color
        size = shot.camera.width, shot.camera.height
        if self._target is None or (self._target.width, self._target.height) != size:
            self._target = gpu.types.GPUOffScreen(*size, format="RGBA16F")
        self._holds = None  # until it is drawn
        if took is None:
            card.draw(self._target, atlas, order, shot, meshes)
        else:
            _wait(self._target)
            began = time.perf_counter()
            card.draw(self._target, atlas, order, shot, meshes)
            _wait(self._target)
            took(time.perf_counter() - began)
        self._holds = (order, shot) if meshes is None else None
        return self._target.texture_color


def _wait(target: gpu.types.GPUOffScreen) -> None:
    """Until all is drawn that was asked for: a pixel is read."""
    with target.bind():
        gpu.state.active_framebuffer_get().read_color(0, 0, 1, 1, 4, 0, "FLOAT")
