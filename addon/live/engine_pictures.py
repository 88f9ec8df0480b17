"""Render engine pictures of views whose splats the graphics card cannot draw; no gpu.

A thread renders them, occluded by objects that Blender has drawn.
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
    """A requested picture, a `render.viewport.ViewRequest`."""

    placed: list[Placed]
    """The objects, none as holdout: live drawing shows holdouts."""
    camera: RenderCamera
    """The view's camera."""
    window: np.ndarray
    """[4, 4] float64, Blender's projection."""
    antialias: str
    """Anti-aliasing setting of the scene."""
    depths: np.ndarray | None
    """Depths of objects hiding splats (`Depths.values`), [H, W] float32; compared by identity."""
    cuts: Cuts
    """Clipping of the view."""
    tinted: Tinted
    """Objects whose selection is shown."""

    def same(self, other: "EngineRequest | None") -> bool:
        """Whether another request is for the same picture."""
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
        """The picture, [H, W, 4] float32, as `color.over_view`.

        Args:
            model: Model of the objects.
            camera: The view's, or one with fewer pixels.
            stop: As for `picture.draw`.
            cancel: As for `picture.draw`.
        """
        options = picture.Options(antialias=self.antialias)
        far = None if self.depths is None else self._far(self.depths, camera)
        visible = self._visible(model)
        drawn = picture.draw(visible, camera, options, far_depths=far, stop=stop, cancel=cancel)
        return over_view(drawn.rgb, drawn.alpha)

    def _visible(self, model: Model) -> Model:
        """The model without clipped and hidden splats, with selected splats tinted."""
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
        """Argument `far_depths` of `picture.draw` at the size of `camera`, [H, W] float32."""
        height, width = depths.shape
        rows = (np.arange(camera.height) + 0.5) * height / camera.height
        columns = (np.arange(camera.width) + 0.5) * width / camera.width
        there = depths[rows.astype(int)[::-1, None], columns.astype(int)]
        far = z_of(there, self.camera, self.window).astype(np.float32)
        far[there >= 1] = np.nan
        return far


def _shown(placed: Placed) -> tuple[object, ...]:
    return placed.part, placed.antialias, placed.edited
