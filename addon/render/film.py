"""From what stands before a camera to the passes of one sharp picture."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..cameras.captures import RenderCamera
from ..cameras.panorama import Panorama
from ..core import CancelFlag
from . import color, picture
from .cube import Window, beyond, unfold
from .scene import Model
from .stage import View

_BLACK, _WHITE = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Film:
    """What a picture is to be."""

    options: picture.Options
    transparent: bool
    """Whether what is not covered is left empty."""
    to_scene: np.ndarray
    """[3, 3], from linear Rec. 709 to the file's working space."""

    def without_depths(self) -> "Film":
        """The same without the pass Depth."""
        return replace(self, options=replace(self.options, depths=False))

    def shoot(
        self, view: View, stop: Callable[[], bool], cancel: CancelFlag | None = None
    ) -> dict[str, np.ndarray]:
        """The passes by name, [H, W, 4] and [H, W] float32, the bottom row first.

        Raises:
            As `picture.draw`.
        """
        if isinstance(view.camera, Panorama):
            return self._unfold(view.model, view.camera, stop)
        rendered = picture.draw(view.model, view.camera, self.options, stop=stop, cancel=cancel)
        share = None
        if view.model.shares is not None:
            # What is behind everything is not cut out either, but it is only there in a full film.
            options = replace(
                self.options, background=_BLACK if self.transparent else _WHITE, depths=False
            )
            model = replace(view.model, splats=view.model.shares)
            share = picture.draw(model, view.camera, options, stop=stop, cancel=cancel).rgb[..., 0]
        elif self.transparent:
            share = rendered.alpha
        passes = {"Combined": color.combined(rendered.rgb, share, to_scene=self.to_scene)}
        if self.options.depths:
            passes["Depth"] = color.z_pass(rendered)
        return passes

    def _unfold(
        self, model: Model, camera: Panorama, stop: Callable[[], bool]
    ) -> dict[str, np.ndarray]:
        def side(camera: RenderCamera, window: Window) -> dict[str, np.ndarray]:
            film = replace(self, options=replace(self.options, window=window))
            return film.shoot(View(model=seen, camera=camera), stop)

        seen = beyond(model, camera)
        passes = unfold(camera, self.options.window, side)
        if not self.transparent and model.shares is None:
            passes["Combined"][..., 3] = 1  # beyond a fisheye's circle it is black
        return passes
