"""Pass renderer: all passes of one sharp picture of a view."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..cameras.panorama import Panorama
from ..cameras.render_camera import RenderCamera
from ..core import CancelFlag, Rendered
from . import color, picture
from .coverage import one_hot
from .cube import beyond, unfold
from .mesh_holdout import Hidden, cut
from .model import Model
from .picture import Window
from .scene import Identity
from .shutter_lens import View

MESHES = "Holdout Meshes"
"""Pass with the coverage of a pixel by holdout meshes as seen through all splats; only made with
such meshes."""
SHARE = "Holdout Meshes Share"
"""Their coverage without splats; made together with `MESHES`, but not a pass of Blender."""
_BLACK, _WHITE = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Film:
    """Settings of a picture."""

    options: picture.Options
    transparent: bool
    """Whether the background stays empty."""
    to_scene: np.ndarray
    """[3, 3], from linear Rec. 709 to the file's working space."""
    over_view: bool = False
    """Whether Combined is drawn over a view's picture (`color.over_view`); a transparent film."""

    def without_depths(self) -> "Film":
        """The film without the pass Depth."""
        return replace(self, options=replace(self.options, depths=False))

    def render(
        self, view: View, stop: Callable[[], bool], cancel: CancelFlag | None = None
    ) -> dict[str, np.ndarray]:
        """The passes by name, float32, the bottom row first: "Combined" [H, W, 4], "Depth" [H, W],
        `MESHES` and `SHARE` [H, W, 1].

        Raises:
            As `picture.draw`.
        """
        if isinstance(view.camera, Panorama):
            return self._unfold(view, view.camera, stop)
        at = view.hidden

        def expose(model: Model, options: picture.Options) -> tuple[Rendered, np.ndarray | None]:
            return _exposed(model, view.camera, options, at, stop, cancel)

        rendered, light = expose(view.model, self.options)
        share = None
        if view.model.shares is not None:
            # The background is not cut out either; a transparent film has none.
            background = _BLACK if self.transparent else _WHITE
            options = replace(self.options, background=background, depths=False)
            model = replace(view.model, splats=view.model.shares)
            share = expose(model, options)[0].rgb[..., 0]
        elif self.transparent:
            share = rendered.alpha
        elif light is not None:
            share = rendered.alpha + light
        if self.over_view:
            made = color.over_view(rendered.rgb, share)
        else:
            made = color.combined(rendered.rgb, share, to_scene=self.to_scene)
        passes = {"Combined": made}
        if light is not None:
            passes[MESHES] = (1 - rendered.alpha - light)[::-1, :, None].copy()
            passes[SHARE] = at.inside(self.options.window).share[::-1, :, None].copy()
        if self.options.depths:
            passes["Depth"] = color.z_pass(rendered)
        return passes

    def coverage(self, view: View, stop: Callable[[], bool]) -> dict[Identity, np.ndarray]:
        """Coverage of each pixel by each object, [H, W] float32, the bottom row first.

        Draws one more picture per three objects; errors as `render`.
        """
        found = {}
        for three, model in one_hot(view.model):
            weights = self._weights(view, model, self.options.window, stop)
            for i, owner in enumerate(three):
                found[owner] = np.ascontiguousarray(weights[..., i])
        return found

    def _weights(
        self, view: View, model: Model, window: Window | None, stop: Callable[[], bool]
    ) -> np.ndarray:
        """Picture [H, W, 4] of a model at the place of the view's; the last channel is unused."""
        if isinstance(view.camera, Panorama):

            def side(camera: RenderCamera, part: Window) -> dict[str, np.ndarray]:
                return {
                    "Combined": self._weights(replace(view, camera=camera), distant, part, stop)
                }

            distant = beyond(model, view.camera)
            return unfold(view.camera, window, side)["Combined"]
        options = replace(self.options, background=_BLACK, depths=False, window=window)
        rgb = _exposed(model, view.camera, options, view.hidden, stop, None)[0].rgb
        return np.pad(np.clip(rgb, 0, 1)[::-1], ((0, 0), (0, 0), (0, 1)))

    def _unfold(
        self, view: View, camera: Panorama, stop: Callable[[], bool]
    ) -> dict[str, np.ndarray]:
        def side(camera: RenderCamera, window: Window) -> dict[str, np.ndarray]:
            film = replace(self, options=replace(self.options, window=window))
            return film.render(replace(view, model=distant, camera=camera), stop)

        distant = beyond(view.model, camera)
        passes = unfold(camera, self.options.window, side)
        if not (self.transparent or view.model.shares or view.holdouts):
            passes["Combined"][..., 3] = 1  # black outside of a fisheye's circle
        return passes


def _exposed(
    model: Model,
    camera: RenderCamera,
    options: picture.Options,
    at: Hidden | None,
    stop: Callable[[], bool],
    cancel: CancelFlag | None,
) -> tuple[Rendered, np.ndarray | None]:
    """A picture, and with holdout meshes the share of the background that shows."""
    if at is None:
        return picture.draw(model, camera, options, stop=stop, cancel=cancel), None
    bare = replace(options, background=_BLACK)
    before = picture.draw(model, camera, bare, far_depths=at.far, stop=stop, cancel=cancel)
    part, free = at.inside(options.window), None
    if part.edges is not None:
        left, top, width, height = part.edges
        window = options.window or (0, 0)
        edges = replace(bare, window=(left + window[0], top + window[1], width, height))
        free = picture.draw(model, camera, edges, stop=stop, cancel=cancel)
    drawn, light = cut(before, free, part)
    rgb = drawn.rgb + light[..., None] * np.array(options.background, np.float32)
    return replace(drawn, rgb=rgb), light
