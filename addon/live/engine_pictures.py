"""Render engine pictures of views whose splats the graphics card cannot draw; no gpu.

A thread renders them, occluded by what Blender has drawn.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..cameras.render_camera import RenderCamera
from ..core import CancelFlag
from ..render import picture
from ..render.color import over_view
from ..render.model import Model
from ..render.scene import Placed
from ..render.selections import Tinted, marked
from .clip import Cuts, z_of


@dataclass(frozen=True, kw_only=True)
class EngineRequest:
    """A picture that is wanted, as `render.viewport.Wish`."""

    placed: list[Placed]
    """None of them held out: views show what is, as long as it is drawn live."""
    camera: RenderCamera
    """Of the view."""
    window: np.ndarray
    """[4, 4] float64, Blender's projection."""
    antialias: str
    """What the scene wishes."""
    depths: np.ndarray | None
    """[H, W] float32 of what hides splats (`Depths.values`), another array where they differ."""
    cuts: Cuts
    """Where the view ends."""
    tinted: Tinted
    """Of which objects what is selected is seen."""

    def same(self, other: "EngineRequest | None") -> bool:
        """Whether the other picture is this one."""
        return (
            other is not None
            and list(map(_shown, self.placed)) == list(map(_shown, other.placed))
            and all(
                a.frozen is b.frozen and np.array_equal(a.matrix, b.matrix)
                for a, b in zip(self.placed, other.placed, strict=True)
            )
            and self.camera.same(other.camera)
            and np.array_equal(self.window, other.window)
            and (self.antialias, self.tinted) == (other.antialias, other.tinted)
            and self.depths is other.depths
            and self.cuts.same(other.cuts)
        )

    def shoot(
        self, model: Model, camera: RenderCamera, stop: Callable[[], bool], cancel: CancelFlag
    ) -> np.ndarray:
        """[H, W, 4] float32, as `color.over_view`.

        Args:
            model: Of the objects.
            camera: The view's, or one with fewer pixels.
            stop: As `picture.draw`.
            cancel: As `picture.draw`.
        """
        options = picture.Options(antialias=self.antialias)
        far = None if self.depths is None else self._far(self.depths, camera)
        seen = self._seen(model)
        drawn = picture.draw(seen, camera, options, far_depths=far, stop=stop, cancel=cancel)
        return over_view(drawn.rgb, drawn.alpha)

    def _seen(self, model: Model) -> Model:
        """Without what is cut off or hidden, and with what is selected tinted."""
        splats = marked(model, self.placed, self.tinted).splats
        if self.cuts.far or len(self.cuts.planes):
            matrix = (self.camera.viewmat @ model.matrix).astype(np.float32)
            places = splats.means @ matrix[:3, :3].T + matrix[:3, 3]
            there = self.cuts.kept(places, self.camera, self.window)
            splats = splats if there.all() else splats.subset(there)
        return Model(
            splats=splats, matrix=model.matrix, antialias=model.antialias, plain=model.plain
        )

    def _far(self, depths: np.ndarray, camera: RenderCamera) -> np.ndarray:
        """[H, W] float32, as `picture.draw` takes it, of a camera that may have fewer pixels."""
        height, width = depths.shape
        rows = (np.arange(camera.height) + 0.5) * height / camera.height
        columns = (np.arange(camera.width) + 0.5) * width / camera.width
        there = depths[rows.astype(int)[::-1, None], columns.astype(int)]
        far = z_of(there, self.camera, self.window).astype(np.float32)
        far[there >= 1] = np.nan
        return far


def _shown(placed: Placed) -> tuple[object, ...]:
    return placed.part, placed.antialias, placed.edited
