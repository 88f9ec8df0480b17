"""CpuModel renderer: images of the splats in training for viewers, metrics and decisions."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from ...config import Background, TrainConfig
from ...engine.cpu.model import CpuModel
from ...live.viewer_protocol import FrameRequest
from ...raster.header import OUT_INVERSE_DEPTH
from ...raster.loss import image_loss
from ...raster.request import Frustum, Settings
from ...raster.training_rasterizer import Picture, TrainingRasterizer
from ...scene import Cameras
from ..model.ensemble import merge_models
from ..model.training_frame import TrainingFrame
from ..photos.image_pyramid import ImagePyramid, SizedView, training_camera
from ..photos.view_sampler import Photos
from ..region.frozen_splats import FrozenRasterizer, FrozenSplats
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

_Color = tuple[float, float, float]


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
        models: Callable[[], list[CpuModel]],
        *,
        cache: int | None = None,
        frozen: FrozenSplats | None = None,
    ) -> None:
        """Create the renderer.

        Args:
            config: The options.
            photos: The capture.
            frame: The training frame.
            cameras: Cameras of `photos` in the training frame.
            photo_parameters: Optimised gains and poses.
            models: Returns the models, which are merged for rendering.
            cache: Bytes of photos to keep; None: all.
            frozen: Frozen splats, rendered with the model.
        """
        self._config = config
        self._photos = photos
        self._frame = frame
        self._photo_parameters = photo_parameters
        self._pyramid = ImagePyramid(photos, cameras, near=frame.near, limit=cache)
        self._frozen = frozen
        self.rasterizer = TrainingRasterizer() if frozen is None else FrozenRasterizer(frozen)
        """The rasterizer, shared with the training steps to share its memory."""
        self.models = models
        """Returns the models to render."""
        self._merged: tuple[list[dict[str, torch.Tensor]], dict[str, torch.Tensor]] | None = None
        """Parameters of the models, and of their merged model."""

    @property
    def background(self) -> _Color:
        """Background colour for viewers and metrics."""
        return COLORS.get(self._config.background, COLORS[Background.BLACK])

    def splats(self) -> dict[str, torch.Tensor]:
        """Raw parameters of the rendered splats, training frame; valid until the next step."""
        parts = [model.synced(threads=self._config.threads) for model in self.models()]
        if len(parts) == 1:
            return parts[0]
        before, merged = self._merged or ([], {})
        if len(before) != len(parts) or any(a is not b for a, b in zip(before, parts, strict=True)):
            merged = merge_models(parts)
            self._merged = parts, merged
        return merged

    def forget(self) -> None:
        """Free the cached parameters for rendering between two steps."""
        self._merged = None

    def view(self, index: int, factor: float = 1.0) -> Frustum:
        """View `index` with sides divided by `factor`, at its refined camera pose."""
        return self._photo_parameters.at_refined_pose(self._pyramid.view(index, factor), index)

    def sized(self, index: int, factor: float, *, upcoming: Sequence[int] = ()) -> SizedView:
        """View `index` with its photo, sides divided by `factor`, at its refined camera pose.

        `upcoming`: the next views, for prefetching.
        """
        found = self._pyramid.at(index, factor, upcoming=upcoming)
        if self._frozen is not None and self._photos.mask_mode == "ignore":
            found = mask_to_region(found, self.models()[0].params)
        return found._replace(view=self._photo_parameters.at_refined_pose(found.view, index))

    def background_before_gain(self, background: _Color, gain: torch.Tensor | None) -> _Color:
        """Background colour before the gain, so that `background` shows after it, if photos are
        composited over it. Otherwise the background is part of the scene and exposed with it."""
        if gain is None or self._photos.mask_mode != "composite":
            return background
        return background_before_gain(background, gain)

    def picture(self, index: int, *, background: _Color) -> torch.Tensor:
        """Render view `index` with the photo's gain, if any: [H, W, 3] float32, a copy."""
        return self._exposed(index, self.view(index), background).clone()

    def aligned_picture(self, index: int, *, background: _Color) -> torch.Tensor:
        """Render view `index` at the pose that matches its photo best, [H, W, 3] float32, a copy;
        its camera is unchanged."""
        config, full = self._config, self.view(index)
        factor = max(1.0, max(full.width, full.height) / _ALIGNED_SIDE)
        settings = Settings(
            antialias=config.antialias, threads=config.threads, background=background
        )
        synced = self.splats()
        pose = align_pose(
            synced if self._frozen is None else self._frozen.before(synced),
            self.sized(index, factor),
            settings,
            mask_mode=self._photos.mask_mode,
            unit=self._frame.extent,
        )
        return self._show(replace(full, viewmat=pose), background=background).rgb.clone()

    def render_request(self, request: FrameRequest) -> torch.Tensor:
        """Render a frame request of a viewer, [height, width, 3] float32."""
        viewmats = self._frame.similarity.viewmats_to_training(request.viewmat[None])
        size = request.width, request.height
        view = training_camera(viewmats[0], request.K, *size, self._frame.near)
        shown = dict(self.splats())
        if request.scaling != 1:
            shown["scales"] = shown["scales"] + math.log(request.scaling)
        return self._draw(shown, view, background=self.background).rgb

    def shows_splats(self, index: int) -> bool:
        """Return whether any splat is drawn in view `index`; rendered at an eighth of its size."""
        view = self.view(index)
        factor = min(_CHECK_FACTOR, view.width, view.height)
        width, height = view.width // factor, view.height // factor
        K = view.K / view.K.new_tensor([[factor], [factor], [1]])
        small = replace(view, K=K, width=width, height=height)
        return bool((self._show(small).alpha > 0).any())

    def error(self, indices: Sequence[int], factor: float) -> float:
        """Root mean squared error of the unmasked pixels of these views, with sides divided by
        `factor`."""
        background, total = self.background, 0.0
        for index in indices:
            view, image, mask, _, counted = self.sized(index, factor)
            loss = image_loss(
                self._exposed(index, view, background),
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
        found = self._show(self.view(index), outputs=OUT_INVERSE_DEPTH)
        assert found.inverse_depth is not None
        scale = np.float32(self._frame.similarity.scale)
        return found.inverse_depth.numpy() * scale, found.alpha.numpy().copy()

    def _exposed(self, index: int, view: Frustum, background: _Color) -> torch.Tensor:
        """Render `view`, the view of photo `index` at any size, with the photo's gain."""
        gain = self._photo_parameters.gain_of(index)
        picture = self._show(view, background=self.background_before_gain(background, gain)).rgb
        return picture if gain is None else picture.mul_(gain)

    def _show(self, view: Frustum, **options: Any) -> Picture:
        return self._draw(self.splats(), view, **options)

    def _draw(self, splats: dict[str, torch.Tensor], view: Frustum, **options: Any) -> Picture:
        """Render a view; `options` are those of `Settings`."""
        config = self._config
        settings = Settings(antialias=config.antialias, threads=config.threads, **options)
        return self.rasterizer.draw(tuple(splats.values()), view, settings)


def mse_of_unmasked(mse: float, counted: float) -> float:
    """Mean squared error of the unmasked pixels, a share `counted` of all, if the others have no
    error; 0 without any."""
    return mse / counted if counted > 0 else 0.0
