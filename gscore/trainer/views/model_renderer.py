"""Model renderer: images of the splats in training for viewers, metrics and decisions."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch

from ...config import Background, TrainConfig
from ...engine.base import Color, DrawnPicture, Engine, EngineModel
from ...engine.cpu.loss import mse_of_unmasked
from ...live.viewer_protocol import FrameRequest
from ...metrics.evaluate import target_picture
from ...photo_exposure import PhotoExposure
from ...raster import native_library
from ...raster.loss import image_loss
from ...raster.request import Frustum
from ...shared_constants import EPS2D, JACOBIAN_MARGIN, REACH
from ..model.training_frame import TrainingFrame
from ..photos.image_pyramid import ImagePyramid, SizedView, training_camera
from ..photos.view_sampler import Photos
from .photo_blurs import BlurFit, fit_blur
from .photo_parameters import PhotoParameters
from .photo_poses import align_pose
from .transient_search import Residual, residual_of
from .transients import Transients


def mask_to_region(found: SizedView, means: np.ndarray, scales: np.ndarray) -> SizedView:
    """Mask a view to the tiles in which splats with these raw parameters may be drawn.

    All other pixels do not depend on these splats.
    """
    view, side = found.view, native_library.TILE
    tiles = tiles_of_splats(means, scales, view)
    shown = np.repeat(np.repeat(tiles, side, axis=0), side, axis=1) * np.uint8(255)
    return found.masked(np.ascontiguousarray(shown[: view.height, : view.width]))


def tiles_of_splats(means: np.ndarray, scales: np.ndarray, view: Frustum) -> np.ndarray:
    """Return [ceil(H / 16), ceil(W / 16)] uint8, 1 where splats with means [N, 3] and log scales
    [N, 3] may be drawn, bounded by discs with the radius of the longest axis."""
    viewmat, K = (np.asarray(a, np.float64) for a in (view.viewmat, view.K))
    place = means @ viewmat[:3, :3].T + viewmat[:3, 3]
    widest = scales.max(axis=1, initial=-np.inf)
    drawn = (place[:, 2] > view.near) & np.isfinite(place).all(axis=1) & np.isfinite(widest)
    (x, y, z), sigma = place[drawn].T, np.exp(widest[drawn].astype(np.float64))
    x, y, focal = x / z, y / z, max(K[0, 0], K[1, 1])
    # Upper bound of the norm of the projection's Jacobian.
    tangents = np.minimum(np.abs(x), _most(K[0, 0], K[0, 2], view.width)) ** 2
    tangents += np.minimum(np.abs(y), _most(K[1, 1], K[1, 2], view.height)) ** 2
    radius = REACH * np.sqrt((focal / z * sigma) ** 2 * (1 + tangents) + EPS2D) + 1
    left, right = _tiles(K[0, 0] * x + K[0, 2], radius, view.width)
    top, bottom = _tiles(K[1, 1] * y + K[1, 2], radius, view.height)
    return _covered(top, bottom, left, right, (view.height, view.width))


def _most(focal: float, centre: float, size: int) -> float:
    """Largest tangent of a direction after the clamping."""
    return (max(centre, size - centre) + JACOBIAN_MARGIN * size) / focal


def _tiles(centre: np.ndarray, radius: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return first tile and end tile of each splat along an axis, clamped to the view."""
    count = -(-size // native_library.TILE)
    first = np.clip(np.floor((centre - radius) / native_library.TILE), 0, count)
    end = np.clip(np.floor((centre + radius) / native_library.TILE) + 1, 0, count)
    return first.astype(np.int64), end.astype(np.int64)


def _covered(
    top: np.ndarray,
    bottom: np.ndarray,
    left: np.ndarray,
    right: np.ndarray,
    size: tuple[int, int],
) -> np.ndarray:
    """Return the tiles covered by any rectangle: corner counts, then cumulative sums."""
    rows, columns = (-(-n // native_library.TILE) for n in size)
    counts = np.zeros((rows + 1) * (columns + 1), np.int64)
    corners = ((top, left, 1), (bottom, right, 1), (top, right, -1), (bottom, left, -1))
    for row, column, sign in corners:
        counts += sign * np.bincount(row * (columns + 1) + column, minlength=len(counts))
    sums = counts.reshape(rows + 1, columns + 1).cumsum(axis=0).cumsum(axis=1)
    return (sums[:rows, :columns] > 0).astype(np.uint8)


COLORS = {Background.BLACK: (0.0, 0.0, 0.0), Background.WHITE: (1.0, 1.0, 1.0)}
"""Constant backgrounds."""
_ALIGNED_SIDE = 400
"""Longer side of the image for the alignment of a held-out camera, px."""
_CHECK_FACTOR = 8
"""Divisor of a photo's sides for the check whether a view shows any splat."""


@dataclass(eq=False)
class ModelRenderer:
    """Renderer of the current models. Rendering changes no bit of the training.

    Pictures are valid until the next one is rendered, unless stated otherwise.
    """

    config: TrainConfig
    """The options."""
    photos: Photos
    """The capture."""
    frame: TrainingFrame
    """The training frame."""
    pyramid: ImagePyramid
    """The views in the training frame."""
    photo_parameters: PhotoParameters
    """Gains, poses, blurs and transients of the photos."""
    engine: Engine[Any]
    """Draws the models."""
    models: Callable[[], list[EngineModel]]
    """Returns the models, which are merged for rendering."""
    region: bool
    """True: frozen splats surround the model, so photos count only where it may be drawn."""
    _masked: dict[int, tuple[tuple[int, ...], SizedView]] = field(default_factory=dict, init=False)
    """Masked views by photo, with the step of their transients and their size."""

    @property
    def background(self) -> Color:
        """Background colour for viewers and metrics."""
        return COLORS.get(self.config.background, COLORS[Background.BLACK])

    def view(self, index: int, factor: float = 1.0) -> Frustum:
        """View `index` with sides divided by `factor`, at its refined camera pose."""
        return self.photo_parameters.at_refined_pose(self.pyramid.view(index, factor), index)

    def sized(self, index: int, factor: float, *, upcoming: Iterable[int] = ()) -> SizedView:
        """View `index` with its photo, sides divided by `factor`, at its refined camera pose.

        `upcoming`: the next views, for prefetching.
        """
        found = self.pyramid.at(index, factor, upcoming=upcoming)
        if self.region and self.photos.mask_mode == "ignore":
            (model,) = self.models()
            found = mask_to_region(found, model.column("means"), model.column("scales"))
        if self.photo_parameters.transients is not None:
            found = self._without_transients(self.photo_parameters.transients, found, index)
        return found._replace(view=self.photo_parameters.at_refined_pose(found.view, index))

    def _without_transients(
        self, transients: Transients, found: SizedView, index: int
    ) -> SizedView:
        """View `index` with its transients masked."""
        key = transients.step, found.view.width, found.view.height
        known, masked = self._masked.get(index, ((), found))
        if known == key:
            return masked
        mask = transients.of(index, *key[1:])
        if mask is None:
            return found
        masked = found.masked(mask)
        if self.pyramid.keeps_all:
            self._masked[index] = key, masked
        return masked

    def background_before_gain(self, background: Color, gain: Color | None) -> Color:
        """Background colour before the gain, so that `background` shows after it, if photos are
        composited over it. Otherwise the background is part of the scene and exposed with it."""
        if self.photos.mask_mode != "composite":
            return background
        return PhotoExposure.of(gain).behind(background)

    def picture(self, index: int, *, background: Color) -> np.ndarray:
        """Render view `index` with the photo's gain, if any, that of a held-out photo predicted:
        [H, W, 3] float32, a copy."""
        return self._exposed(index, self.view(index), background).rgb.copy()

    def aligned_picture(self, index: int, *, background: Color) -> np.ndarray:
        """Render view `index` at the pose that matches its photo best, [H, W, 3] float32, a copy;
        its camera is unchanged."""
        full = self.view(index)
        sized = self.sized(index, max(1.0, max(full.width, full.height) / _ALIGNED_SIDE))
        photo = sized.photo(self.photos.mask_mode)

        def gradient(view: Frustum) -> np.ndarray:
            return self.engine.pose_gradient(
                self.models(),
                view,
                photo,
                background=background,
                antialias=self.config.antialias,
            )

        pose = align_pose(gradient, sized.view, unit=self.frame.extent)
        return self._exposed(index, replace(full, viewmat=pose), background).rgb.copy()

    def render_request(self, request: FrameRequest) -> np.ndarray:
        """Render a frame request of a viewer, [height, width, 3] float32."""
        viewmats = self.frame.similarity.viewmats_to_training(request.viewmat[None])
        size = request.width, request.height
        view = training_camera(viewmats[0], request.K, *size, self.frame.near)
        return self._draw(view, self.background, scaling=request.scaling).rgb

    def shows_splats(self, index: int) -> bool:
        """Return whether any splat is drawn in view `index`; rendered at an eighth of its size."""
        view = self.view(index)
        factor = min(_CHECK_FACTOR, view.width, view.height)
        width, height = view.width // factor, view.height // factor
        K = np.asarray(view.K) / np.array([[factor], [factor], [1]], np.float32)
        small = replace(view, K=K, width=width, height=height)
        return bool((self._draw(small).alpha > 0).any())

    def error(self, indices: Sequence[int], factor: float) -> float:
        """Root mean squared error of the unmasked pixels of these views, with sides divided by
        `factor`."""
        background, total = self.background, 0.0
        for index in indices:
            sized = self.sized(index, factor)
            photo, mask = sized.photo(self.photos.mask_mode), sized.mask
            loss = image_loss(
                torch.from_numpy(self._exposed(index, sized.view, background).rgb),
                torch.from_numpy(photo.image),
                mask=None if mask is None else torch.from_numpy(mask),
                mask_mode="none" if mask is None else photo.mask_mode,
                background=background,
                threads=self.config.threads,
            )
            total += mse_of_unmasked(loss.mse, photo.counted)
        return math.sqrt(total / len(indices))

    def photo_blur(self, index: int, factor: float, *, upcoming: Iterable[int] = ()) -> BlurFit:
        """Measure the blur of photo `index`, its sides divided by `factor`, relative to the sharp
        render of its view, in squares of the photo's longer side; `upcoming`: see `sized`."""
        sized = self.sized(index, factor, upcoming=upcoming)
        # Photos end at white.
        render = np.minimum(self._exposed(index, sized.view, self.background).rgb, 1)
        view = sized.view
        mode = sized.photo(self.photos.mask_mode).mask_mode
        target, weights = target_picture(sized.image, sized.mask, mode, self.background)
        fit = fit_blur(render, target, weights, threads=self.config.threads)
        return fit._replace(covariance=fit.covariance / max(view.width, view.height) ** 2)

    def residual(self, index: int, factor: float, *, upcoming: Iterable[int] = ()) -> Residual:
        """Compare photo `index`, its sides divided by `factor`, with the render of its view; what
        was masked as transient counts too. `upcoming`: see `sized`."""
        sized = self.pyramid.at(index, factor, upcoming=upcoming)
        view = self.photo_parameters.at_refined_pose(sized.view, index)
        drawn = self._exposed(index, view, self.background, inverse_depth=True)
        assert drawn.inverse_depth is not None
        return residual_of(
            view,
            np.minimum(drawn.rgb, 1),  # photos end at white
            sized.image,
            sized.mask if self.photos.mask_mode == "ignore" else None,
            inverse_depth=drawn.inverse_depth,
            alpha=drawn.alpha,
            threads=self.config.threads,
        )

    def inverse_depth(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Render accumulated inverse depth, 1/world unit, and opacity of view `index`, [H, W]
        float32 each."""
        found = self._draw(self.view(index), inverse_depth=True)
        assert found.inverse_depth is not None
        scale = np.float32(self.frame.similarity.scale)
        return found.inverse_depth * scale, found.alpha.copy()

    def _exposed(
        self, index: int, view: Frustum, background: Color, *, inverse_depth: bool = False
    ) -> DrawnPicture:
        """Render `view`, the view of photo `index` at any size, with the photo's gain."""
        gain = self.photo_parameters.gain_of(index)
        behind = self.background_before_gain(background, gain)
        drawn = self._draw(view, behind, inverse_depth=inverse_depth)
        return drawn._replace(rgb=PhotoExposure.of(gain).apply(drawn.rgb))

    def _draw(
        self,
        view: Frustum,
        background: Color = (0.0, 0.0, 0.0),
        *,
        inverse_depth: bool = False,
        scaling: float = 1.0,
    ) -> DrawnPicture:
        return self.engine.draw(
            self.models(),
            view,
            background=background,
            antialias=self.config.antialias,
            inverse_depth=inverse_depth,
            scaling=scaling,
        )
