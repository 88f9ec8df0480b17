"""Model renderer: images of the splats in training for viewers, metrics and decisions."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from ...config import Background, TrainConfig
from ...engine.base import Color, DrawnPicture, Engine, EngineModel
from ...engine.cpu.loss import mse_of_unmasked
from ...live.viewer_protocol import FrameRequest
from ...raster.loss import image_loss
from ...raster.request import Frustum
from ...scene import Cameras
from ..model.training_frame import TrainingFrame
from ..photos.image_pyramid import ImagePyramid, SizedView, training_camera
from ..photos.view_sampler import Photos
from ..region.region_tiles import mask_to_region
from .photo_gains import background_before_gain
from .photo_parameters import PhotoParameters
from .pose_alignment import align_pose

COLORS = {Background.BLACK: (0.0, 0.0, 0.0), Background.WHITE: (1.0, 1.0, 1.0)}
"""Constant backgrounds."""
_ALIGNED_SIDE = 400
"""Longer side of the image for the alignment of a held-out camera, px."""
_CHECK_FACTOR = 8
"""Divisor of a photo's sides for the check whether a view shows any splat."""


class ModelRenderer:
    """Renderer of the current models. Rendering changes no bit of the training.

    Pictures are valid until the next one is rendered, unless stated otherwise.
    """

    def __init__(
        self,
        config: TrainConfig,
        photos: Photos,
        frame: TrainingFrame,
        cameras: Cameras,
        photo_parameters: PhotoParameters,
        engine: Engine[Any],
        models: Callable[[], list[EngineModel]],
        *,
        cache: int | None = None,
        region: bool = False,
    ) -> None:
        """Create the renderer.

        Args:
            config: The options.
            photos: The capture.
            frame: The training frame.
            cameras: Cameras of `photos` in the training frame.
            photo_parameters: Optimised gains and poses.
            engine: Draws the models.
            models: Returns the models, which are merged for rendering.
            cache: Bytes of photos to keep; None: all.
            region: True: frozen splats surround the model, so photos count only where it may be
                drawn.
        """
        self._config = config
        self._photos = photos
        self._frame = frame
        self._photo_parameters = photo_parameters
        self._pyramid = ImagePyramid(photos, cameras, near=frame.near, limit=cache)
        self._region = region
        self._engine = engine
        self._models = models

    @property
    def background(self) -> Color:
        """Background colour for viewers and metrics."""
        return COLORS.get(self._config.background, COLORS[Background.BLACK])

    def view(self, index: int, factor: float = 1.0) -> Frustum:
        """View `index` with sides divided by `factor`, at its refined camera pose."""
        return self._photo_parameters.at_refined_pose(self._pyramid.view(index, factor), index)

    def sized(self, index: int, factor: float, *, upcoming: Sequence[int] = ()) -> SizedView:
        """View `index` with its photo, sides divided by `factor`, at its refined camera pose.

        `upcoming`: the next views, for prefetching.
        """
        found = self._pyramid.at(index, factor, upcoming=upcoming)
        if self._region and self._photos.mask_mode == "ignore":
            (model,) = self._models()
            found = mask_to_region(found, model.column("means"), model.column("scales"))
        return found._replace(view=self._photo_parameters.at_refined_pose(found.view, index))

    def background_before_gain(self, background: Color, gain: torch.Tensor | None) -> Color:
        """Background colour before the gain, so that `background` shows after it, if photos are
        composited over it. Otherwise the background is part of the scene and exposed with it."""
        if gain is None or self._photos.mask_mode != "composite":
            return background
        return background_before_gain(background, gain)

    def picture(self, index: int, *, background: Color) -> np.ndarray:
        """Render view `index` with the photo's gain, if any, that of a held-out photo predicted:
        [H, W, 3] float32, a copy."""
        return self._exposed(index, self.view(index), background).copy()

    def aligned_picture(self, index: int, *, background: Color) -> np.ndarray:
        """Render view `index` at the pose that matches its photo best, [H, W, 3] float32, a copy;
        its camera is unchanged."""
        full = self.view(index)
        sized = self.sized(index, max(1.0, max(full.width, full.height) / _ALIGNED_SIDE))
        photo = sized.photo(self._photos.mask_mode)

        def gradient(view: Frustum) -> np.ndarray:
            return self._engine.pose_gradient(
                self._models(),
                view,
                photo,
                background=background,
                antialias=self._config.antialias,
            )

        pose = align_pose(gradient, sized.view, unit=self._frame.extent)
        return self._exposed(index, replace(full, viewmat=pose), background).copy()

    def render_request(self, request: FrameRequest) -> np.ndarray:
        """Render a frame request of a viewer, [height, width, 3] float32."""
        viewmats = self._frame.similarity.viewmats_to_training(request.viewmat[None])
        size = request.width, request.height
        view = training_camera(viewmats[0], request.K, *size, self._frame.near)
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
            view, image, mask, _, counted = self.sized(index, factor)
            loss = image_loss(
                torch.from_numpy(self._exposed(index, view, background)),
                torch.from_numpy(image),
                mask=None if mask is None else torch.from_numpy(mask),
                mask_mode="none" if mask is None else self._photos.mask_mode,
                background=background,
                threads=self._config.threads,
            )
            total += mse_of_unmasked(loss.mse, counted)
        return math.sqrt(total / len(indices))

    def inverse_depth(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Render accumulated inverse depth, 1/world unit, and opacity of view `index`, [H, W]
        float32 each."""
        found = self._draw(self.view(index), inverse_depth=True)
        assert found.inverse_depth is not None
        scale = np.float32(self._frame.similarity.scale)
        return found.inverse_depth * scale, found.alpha.copy()

    def _exposed(self, index: int, view: Frustum, background: Color) -> np.ndarray:
        """Render `view`, the view of photo `index` at any size, with the photo's gain."""
        gain = self._photo_parameters.gain_of(index)
        picture = self._draw(view, self.background_before_gain(background, gain)).rgb
        if gain is not None:
            picture *= gain.numpy()
        return picture

    def _draw(
        self,
        view: Frustum,
        background: Color = (0.0, 0.0, 0.0),
        *,
        inverse_depth: bool = False,
        scaling: float = 1.0,
    ) -> DrawnPicture:
        return self._engine.draw(
            self._models(),
            view,
            background=background,
            antialias=self._config.antialias,
            inverse_depth=inverse_depth,
            scaling=scaling,
        )
