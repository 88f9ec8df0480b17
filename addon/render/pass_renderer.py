"""Pass renderer: all passes of one sharp picture of a view.

With holdouts these include data with which the compositor cuts meshes and the world. `HOLDOUT` is
the share of light that holdout splats block by themselves. `HOLDOUT_BEHIND` is the share of the
background to remove, beyond the picture's alpha. `HOLDOUT_DEPTH` is the depth of the holdout
splats; *Depth* is then that of the other splats. `HOLDOUT_EDGE` is the picture's alpha in the
part of a pixel that holdout meshes leave free.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ..cameras.panorama import Panorama
from ..cameras.render_camera import RenderCamera
from ..core import CancelFlag, Rendered, rgb_to_sh0
from . import color, picture
from .cube import beyond, unfold
from .geometry_passes import normal_pass
from .holdout_meshes import Hidden, cut
from .model import HALF, Model
from .picture import Window
from .scene import Identity
from .shutter_lens import View
from .splat_values import NUMBER, SHADOW

MESHES = "Holdout Meshes"
"""Pass with the coverage of a pixel by holdout meshes as seen through all splats; only made with
such meshes."""
SHARE = "Holdout Meshes Share"
"""Their coverage without splats; made together with `MESHES`, but not a pass of Blender."""
HOLDOUT, HOLDOUT_BEHIND, HOLDOUT_DEPTH = "Holdout", "Holdout Behind", "Holdout Depth"
HOLDOUT_EDGE = "Holdout Beside"
HOLDOUT_PASSES = HOLDOUT, HOLDOUT_BEHIND, HOLDOUT_DEPTH, MESHES, HOLDOUT_EDGE
"""Names of the passes with which the compositor cuts at holdouts, in their order."""
_FULL = 1e-4
"""Transmittance below which the background is taken as hidden."""
_PART = 1 / 16
"""Least part of a pixel that gets its own alpha; smaller ones are unreliable in lens means."""
_BLACK, _WHITE = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)

Stop = Callable[[], bool]


class Shot(NamedTuple):
    """Pictures of one view, or their means over several; all float32, the bottom row first."""

    passes: dict[str, np.ndarray]
    """Rendered passes by name, as `PassRenderer.render` returns them."""
    covered: dict[Identity, np.ndarray]
    """Coverage of each pixel by each object, [H, W]; empty if not requested."""
    blocked: dict[str, np.ndarray]
    """The light that splats block, [H, W]: by holdouts as `HOLDOUT`, by all splats as
    `HOLDOUT_BEHIND`; empty without holdouts, or if not requested."""


@dataclass(frozen=True, kw_only=True)
class PassRenderer:
    """Settings of a picture."""

    options: picture.Options
    transparent: bool
    """Whether the background stays empty."""
    to_scene: np.ndarray
    """[3, 3], from linear Rec. 709 to the file's working space."""
    over_view: bool = False
    """Whether Combined is drawn over a view's picture (`color.over_view`); a transparent film."""
    mattes: bool = False
    """Whether the coverage by each object is requested."""
    holdouts: bool = False
    """Whether `HOLDOUT_PASSES` are requested; with depths and a transparent film."""

    values: Mapping[str, str] = field(default_factory=dict)
    """Passes of values of the splats, by the names of `splat_values`; the models have these."""

    @property
    def at_frame(self) -> bool:
        """Whether there are passes of which means are useless: Depth and numbers of splats."""
        return self.options.depths or NUMBER in self.values

    def without(self, *, at_frame: bool = False, surface: bool = False) -> "PassRenderer":
        """The same without the passes of which means are useless, or without Normal and the other
        values of splats, or both."""
        options = self.options
        kept = {
            "depths": options.depths and not at_frame,
            "normals": options.normals and not surface,
        }
        values = {
            name: made
            for name, made in self.values.items()
            if not (at_frame if name == NUMBER else surface)
        }
        return replace(self, options=replace(options, **kept), values=values)

    def render(
        self, view: View, stop: Stop, cancel: CancelFlag | None = None
    ) -> dict[str, np.ndarray]:
        """The passes by name, float32, the bottom row first: "Combined" [H, W, 4], "Depth" [H, W],
        "Normal" [H, W, 3], `MESHES` and `SHARE` [H, W, 1], and those of `values`: numbers [H, W],
        -1 where nothing blocks half of the light; others [H, W, 3].

        Raises:
            As `picture.draw`.
        """
        if isinstance(view.camera, Panorama):
            return self._unfold(view, view.camera, stop)
        at = view.hidden

        def expose(model: Model, options: picture.Options) -> tuple[Rendered, np.ndarray | None]:
            return _exposed(model, view.camera, options, at, stop, cancel)

        numbers = replace(self.options, median_splats=NUMBER in self.values)
        plain = replace(self.options, depths=False, normals=False)
        rendered, light = expose(view.model, numbers)
        share = None
        if view.model.shares is not None:
            # The background is not cut out either; a transparent film has none.
            options = replace(plain, background=_BLACK if self.transparent else _WHITE)
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
        if self.options.normals:
            passes["Normal"] = normal_pass(rendered, view.camera)
        for name, made in self.values.items():
            if name == NUMBER:
                passes[made] = _numbers(rendered, view.model)
                continue
            shown = expose(_colored(view.model, name), replace(plain, background=_BLACK))[0]
            if name == SHADOW:
                found = shown.rgb + (1 - shown.alpha[..., None])
            else:
                found = shown.rgb @ self.to_scene.T.astype(np.float32)
            passes[made] = np.ascontiguousarray(found[::-1])
        return passes

    def expose(self, view: View, stop: Stop) -> Shot:
        """All pictures of a view; errors as `render`."""
        passes = self.render(view, stop)
        covered = self._coverage(view, stop) if self.mattes else {}
        blocked = {}
        if self.holdouts and view.model.shares is not None:
            whole = replace(view, model=replace(view.model, shares=None))
            shown = {HOLDOUT: _only(view, holdout=True), HOLDOUT_BEHIND: whole}
            plain = self.without(at_frame=True, surface=True)
            blocked = {
                n: plain.render(v, stop)["Combined"][..., 3].copy() for n, v in shown.items()
            }
        return Shot(passes, covered, blocked)

    def completed(self, shot: Shot, view: View, stop: Stop) -> dict[str, np.ndarray]:
        """All passes that Blender stores.

        Args:
            shot: Pictures of this renderer, or their means.
            view: The view at the frame itself, for depths, of which means are useless.
            stop: As for `render`.
        """
        passes = dict(shot.passes)
        if self.holdouts:
            found = dict(shot.blocked)
            if view.model.shares is not None:
                shown = {
                    "Depth": _only(view, holdout=False),
                    HOLDOUT_DEPTH: _only(view, holdout=True),
                }
                plain = replace(self.without(surface=True), values={})
                found |= {name: plain.render(v, stop)["Depth"] for name, v in shown.items()}
            passes |= _holdout_passes(found, passes)
        else:
            passes.pop(MESHES, None)
        passes.pop(SHARE, None)  # internal, not a pass of Blender
        return passes

    def _coverage(self, view: View, stop: Stop) -> dict[Identity, np.ndarray]:
        """`Shot.covered`; draws one more picture per three objects."""
        found = {}
        for three, model in _one_hot(view.model):
            weights = self._weights(view, model, self.options.window, stop)
            for i, owner in enumerate(three):
                found[owner] = np.ascontiguousarray(weights[..., i])
        return found

    def _weights(self, view: View, model: Model, window: Window | None, stop: Stop) -> np.ndarray:
        """Picture [H, W, 4] of a model at the place of the view's; the last channel is unused."""
        if isinstance(view.camera, Panorama):

            def side(camera: RenderCamera, part: Window) -> dict[str, np.ndarray]:
                return {
                    "Combined": self._weights(replace(view, camera=camera), distant, part, stop)
                }

            distant = beyond(model, view.camera)
            return unfold(view.camera, window, side)["Combined"]
        options = replace(
            self.options, background=_BLACK, depths=False, normals=False, window=window
        )
        rgb = _exposed(model, view.camera, options, view.hidden, stop, None)[0].rgb
        return np.pad(np.clip(rgb, 0, 1)[::-1], ((0, 0), (0, 0), (0, 1)))

    def _inverted_shadow(self, passes: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        made = self.values.get(SHADOW)
        return passes | ({made: 1 - passes[made]} if made in passes else {})

    def _unfold(self, view: View, camera: Panorama, stop: Stop) -> dict[str, np.ndarray]:
        def side(camera: RenderCamera, window: Window) -> dict[str, np.ndarray]:
            pass_renderer = replace(self, options=replace(self.options, window=window))
            found = pass_renderer.render(replace(view, model=distant, camera=camera), stop)
            return self._inverted_shadow(found)  # 0 beyond the view

        distant = beyond(view.model, camera)
        passes = self._inverted_shadow(unfold(camera, self.options.window, side))
        if not (self.transparent or view.model.shares or view.holdouts):
            passes["Combined"][..., 3] = 1  # black outside of a fisheye's circle
        return passes


def _exposed(
    model: Model,
    camera: RenderCamera,
    options: picture.Options,
    at: Hidden | None,
    stop: Stop,
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


def _colored(model: Model, name: str) -> Model:
    """A model whose colors are values of its splats."""
    sh0 = rgb_to_sh0(model.values[name]).astype(np.float32)[:, None]
    splats = replace(model.splats, sh0=sh0, shN=np.zeros_like(model.splats.shN[:, :0]))
    return replace(model, splats=splats, shares=None)


def _numbers(rendered: Rendered, model: Model) -> np.ndarray:
    """Numbers of the median splats, [H, W] float32, the bottom row first; -1: there is none."""
    rows = rendered.median_splat
    assert rows is not None
    numbers = np.append(model.values[NUMBER], -1)  # of row -1
    return np.ascontiguousarray(numbers[rows][::-1], np.float32)


def _one_hot(model: Model) -> Iterator[tuple[list[Identity], Model]]:
    """A model with objects coded as colors, so that its pictures are the objects' coverage.

    Yields:
        Up to three objects, and the model with the first in red, the second in green, the third in
        blue and all else black; repeated for all objects except holdouts.
    """
    found = list(dict.fromkeys(owner for owner, _ in model.owners if owner is not None))
    counts = [count for _, count in model.owners]
    for first in range(0, len(found), 3):
        three = found[first : first + 3]
        # Far below black, so that rounding leaves nothing of the other objects.
        colors = np.full((len(counts), 3), -2 * HALF, np.float32)
        for row, (owner, _) in zip(colors, model.owners, strict=True):
            if owner in three:
                row[three.index(owner)] = HALF
        sh0 = np.repeat(colors, counts, axis=0)[:, None]
        splats = replace(model.splats, sh0=sh0, shN=np.zeros_like(model.splats.shN[:, :0]))
        yield three, replace(model, splats=splats, shares=None)


def _holdout_passes(
    found: dict[str, np.ndarray], passes: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """`HOLDOUT_PASSES` from `Shot.blocked` with depths, and from the other passes."""
    picture = passes["Combined"]
    nothing = np.zeros(picture.shape[:2], np.float32)
    meshes, share = (passes.get(n, nothing).reshape(nothing.shape) for n in (MESHES, SHARE))
    found = {MESHES: meshes, HOLDOUT_EDGE: _edge_alpha(picture[..., 3], meshes, share), **found}
    if HOLDOUT not in found:
        far = np.full_like(nothing, color.NOTHING)
        return {**found, HOLDOUT: nothing, HOLDOUT_BEHIND: nothing, HOLDOUT_DEPTH: far}
    light, left = 1 - found[HOLDOUT_BEHIND], 1 - picture[..., 3]
    kept = np.divide(light, left, out=np.zeros_like(light), where=left > _FULL)
    return {**found, HOLDOUT_BEHIND: 1 - np.clip(kept, 0, 1)}


def _edge_alpha(alpha: np.ndarray, meshes: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Alpha in the part of each pixel outside holdout meshes, or of the whole pixel where they
    cover all. At least the whole pixel's alpha, because the meshes hide splats behind them."""
    more = (meshes - share * (1 - alpha)) / np.maximum(1 - share, _PART)
    return np.clip(alpha + more, alpha, np.maximum(alpha, 1))


def _only(view: View, *, holdout: bool) -> View:
    """The view with holdout splats only, or without them."""
    owners, counts = zip(*view.model.owners, strict=True)
    cuts = np.repeat([owner is None for owner in owners], counts)
    return replace(view, model=replace(view.model.subset(cuts == holdout), shares=None))
