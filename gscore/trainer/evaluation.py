"""Evaluation of a model in training: metrics against the photos, and preview images."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import Cancelled
from ..metrics import Evaluation, Lpips, LpipsNet, evaluate
from ..metrics.image import psnr
from ..metrics.photo_renders import PhotoRenders
from ..metrics.trust import state_reach
from ..report import PictureCollector
from ..sampling import evenly_spaced
from ..splats import Splats
from .trainer import Trainer

_TRAIN_VIEWS_SHOWN = 8
"""Most training views that are evaluated if none are held out."""


class Evaluator:
    """Metrics and images of the evaluated views of a trainer."""

    def __init__(
        self, trainer: Trainer, *, lpips: Lpips | LpipsNet | None, lpips_reason: str
    ) -> None:
        self._trainer = trainer
        self._lpips, self._lpips_reason = lpips, lpips_reason
        photos = trainer.photos
        self.split = "test" if photos.test else "train"
        """`test` if the evaluated views are held out."""
        self.indices = list(photos.test) or evenly_spaced(photos.train, _TRAIN_VIEWS_SHOWN)
        """Evaluated views."""

    def picture(self, index: int) -> np.ndarray:
        """Render view `index`, [H, W, 3] float32, over the background of metrics."""
        trainer = self._trainer
        return trainer.renderer.picture(index, background=trainer.renderer.background)

    def measure(
        self, collector: PictureCollector | None, *, interrupted: Callable[[], bool]
    ) -> Evaluation | None:
        """Compute all metrics of all evaluated views.

        Args:
            collector: Receives the images for the report.
            interrupted: Called after each view; True ends the evaluation.

        Returns:
            The metrics, or None if interrupted.
        """

        def on_view(
            place: int,
            target: np.ndarray,
            render: np.ndarray,
            weights: np.ndarray | None,
            values: dict[str, Any],
        ) -> None:
            if interrupted():
                raise Cancelled("The evaluation was interrupted.")
            if self._aligns:
                shown = self._trainer.renderer.aligned_picture(
                    self.indices[place], background=self._trainer.renderer.background
                )
                aligned = psnr(shown, target, mask=weights)
                values["psnr_aligned"] = aligned if math.isfinite(aligned) else None
            if collector:
                collector(place, target, render, weights, values)

        try:
            found = evaluate(
                self.picture,
                self._trainer.photos,
                self.indices,
                lpips=self._lpips,
                lpips_reason=self._lpips_reason,
                background=self._trainer.renderer.background,
                on_view=on_view,
            )
        except Cancelled:
            return None
        if self._aligns:
            each = [value for v in found.views if (value := v["psnr_aligned"]) is not None]
            found.mean["psnr_aligned"] = math.fsum(each) / len(each) if each else None
        return found

    def state_reach(self, found: Evaluation, splats: Splats) -> None:
        """Add what holds for other views than the measured ones, see `metrics.trust.state_reach`.

        Args:
            found: The metrics of the final splats, changed in place.
            splats: The final splats.
        """
        trainer = self._trainer
        photos = trainer.photos
        renders = PhotoRenders(
            splats,
            photos.scene.cameras,
            near=trainer.frame.world_near,
            antialias=trainer.config.antialias,
            threads=trainer.config.threads,
        )
        state_reach(found, renders, photos, split=self.split)

    @property
    def _aligns(self) -> bool:
        """True if held-out cameras are aligned too, because training poses are refined."""
        return self.split == "test" and self._trainer.photo_parameters.poses is not None
