"""Render engine views: 3D views whose splats the graphics card cannot draw; for draw handlers."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..cameras.render_camera import RenderCamera
from ..render.model import SplatCache
from ..render.picture import Window
from ..render.scene import Placed
from ..render.selections import Tinted
from ..render.viewport import Viewport
from .clip import Cuts
from .depths import Depths
from .engine_pictures import EngineRequest


class EngineView:
    """One region of a 3D view: a thread draws its picture, smaller first. The last picture stays
    until the next one is ready."""

    def __init__(self, cache: SplatCache) -> None:
        """Prepare; draws nothing yet."""
        self._viewport = Viewport(cache)
        self.complete = False
        """Whether the last redraw showed the current state completely."""
        self.depths = Depths()

    @property
    def waits(self) -> bool:
        """Whether the picture will change without further input."""
        return self._viewport.painter.busy or self._viewport.painter.fresh

    def stale(self, now: float) -> bool:
        """Whether a redraw would show a new picture."""
        return self._viewport.painter.fresh

    def close(self) -> None:
        """End the thread."""
        self._viewport.painter.close()

    def draw(
        self,
        placed: list[Placed],
        camera: RenderCamera,
        window: np.ndarray,
        antialias: str,
        meshes: Callable[[], np.ndarray] | None,
        *,
        cuts: Cuts,
        tinted: Tinted,
        clip: Window | None,
    ) -> None:
        """Draw the last picture, and request the current one.

        Args:
            placed: The objects.
            camera: The view's camera.
            window: [4, 4] float64, Blender's projection.
            antialias: Anti-aliasing setting of the scene.
            meshes: Reads depths of objects that may hide splats (`Depths.values`). None: none.
            cuts: Clipping of the view.
            tinted: Objects whose selection is shown.
            clip: The part of the view to draw to; None: all.

        Raises:
            ValueError: there is no picture, with the reason.
        """
        request = EngineRequest(
            placed=[replace(one, holdout=False) for one in placed],
            camera=camera,
            window=window,
            antialias=antialias,
            depths=None if meshes is None else meshes(),
            cuts=cuts,
            tinted=tinted,
        )
        painter = self._viewport.painter
        painter.ask(request)
        painter.fresh = False
        self.complete = painter.shows(request)
        pixels = painter.pixels
        if painter.problem:
            raise ValueError(painter.problem)
        if pixels is None:
            return
        self._viewport.draw_over(pixels, clip)
