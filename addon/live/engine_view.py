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
    """One region of a 3D view: a thread draws its picture, smaller first; until it is there, the
    last one stays."""

    def __init__(self, cache: SplatCache) -> None:
        """Nothing is drawn yet."""
        self._viewport = Viewport(cache)
        self.complete = False
        """Whether the last redraw showed everything as it is now."""
        self.depths = Depths()

    @property
    def waits(self) -> bool:
        """Whether the picture will change although nobody touches anything."""
        return self._viewport.painter.busy or self._viewport.painter.fresh

    def stale(self, now: float) -> bool:
        """Whether a redraw would show something else."""
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
        """Draw what is there, and ask for what is missing.

        Args:
            placed: The objects.
            camera: Of the view.
            window: [4, 4] float64, Blender's projection.
            antialias: What the scene wishes.
            meshes: Reads depths of what may hide splats (`Depths.values`). None: nothing does.
            cuts: Where the view ends.
            tinted: Of which objects what is selected is seen.
            clip: The part of the view that shows any of it; None: all.

        Raises:
            ValueError: there is no picture; says why.
        """
        wish = EngineRequest(
            placed=[replace(one, holdout=False) for one in placed],
            camera=camera,
            window=window,
            antialias=antialias,
            depths=None if meshes is None else meshes(),
            cuts=cuts,
            tinted=tinted,
        )
        painter = self._viewport.painter
        painter.ask(wish)
        painter.fresh = False
        self.complete = painter.shows(wish)
        pixels = painter.pixels
        if painter.problem:
            raise ValueError(painter.problem)
        if pixels is None:
            return
        self._viewport.draw_over(pixels, clip)
