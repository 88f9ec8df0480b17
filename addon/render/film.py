"""From what stands before a camera to the passes of one sharp picture."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from . import color, picture
from .stage import View


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

    def shoot(self, view: View, stop: Callable[[], bool]) -> dict[str, np.ndarray]:
        """The passes by name, [H, W, 4] and [H, W] float32, the bottom row first.

        Raises:
            As `picture.draw`.
        """
        rendered = picture.draw(view.model, view.camera, self.options, stop=stop)
        passes = {
            "Combined": color.combined(
                rendered, transparent=self.transparent, to_scene=self.to_scene
            )
        }
        if self.options.depths:
            passes["Depth"] = color.z_pass(rendered)
        return passes
