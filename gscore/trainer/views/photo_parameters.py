"""Photo parameters: gains, poses, blurs and transients of each photo, found with the splats."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...config import TrainConfig
from ...engine.base import Color
from ...events import Decision
from ...raster.request import Frustum
from ..model.training_frame import TrainingFrame
from .photo_adam import rate_at
from .photo_blurs import PhotoBlurs
from .photo_gains import HeldOutGains, PhotoGains, as_gain
from .photo_poses import PhotoPoses, PoseCheck
from .transients import Transients

_START, _STOP = 0.1, 0.8
"""Shares of the run between which poses are refined: before, the splats are too coarse; at the end
they adapt to the final poses."""


@dataclass(eq=False)
class PhotoParameters:
    """Gains, poses, blurs and transients of the photos, each optional, with their updates."""

    config: TrainConfig
    """The options."""
    gains: PhotoGains | None
    """Exposure gains; None: photo colours are used unchanged."""
    poses: PhotoPoses | None
    """Poses of the training cameras; None: those of the capture."""
    blurs: PhotoBlurs | None
    """Blurs of the training photos; None: all photos count as equally sharp."""
    transients: Transients | None
    """Masks of what only single training photos show; None: no such masks."""
    held_out: HeldOutGains
    """Predicts gains of held-out photos."""

    def gain_of(self, index: int) -> Color | None:
        """Gain of photo `index`, predicted if it is held out; None: no gains."""
        if self.gains is None:
            return None
        if index in self.gains:
            return self.gains.of(index)
        return as_gain(self.held_out.predict(self.gains.log_gains)[index])

    def blur_of(self, index: int, view: Frustum) -> Color | None:
        """Covariance xx, xy, yy, px^2, of the blur of photo `index` at the size of `view`; None:
        none."""
        return None if self.blurs is None else self.blurs.of(index, max(view.width, view.height))

    def decisions(self, names: Sequence[str]) -> list[Decision]:
        """Decisions on the photos that were found while training."""
        found = [one.decision(names) for one in (self.blurs, self.transients) if one is not None]
        return [one for one in found if one is not None]

    def all_gains(self) -> np.ndarray | None:
        """Gains of all photos, [V, 3] float64, those of held-out ones predicted; None: no gains."""
        if self.gains is None:
            return None
        values = self.held_out.predict(self.gains.log_gains)
        values[self.gains.train] = self.gains.log_gains[self.gains.train]
        return np.exp(values)

    def at_refined_pose(self, view: Frustum, index: int) -> Frustum:
        """`view`, the view of photo `index` at any size, at its refined pose."""
        return view if self.poses is None else replace(view, viewmat=self.poses.of(index))

    def pose_rate(self, done: float) -> float:
        """Learning rate of poses after this share of the run; 0: no update."""
        if self.poses is None or not self.poses.learns:
            return 0.0
        since, span = done - _START, _STOP - _START
        if not 0 <= since < span:
            return 0.0
        return rate_at(self.config.pose_lr, self.config.pose_lr_final, since / span)

    def learn(
        self, indices: Sequence[int], slopes: np.ndarray, *, done: float, factor: float
    ) -> None:
        """Update gains and poses for each photo of a batch, one after the other.

        Args:
            indices: Training views.
            slopes: [P, 19] float64, one row per view: derivatives of the loss in ln gain of R, G,
                B, and in the 16 entries of the pose matrix.
            done: Share of the run that is done.
            factor: Factor of all rates.
        """
        pose_rate, config = factor * self.pose_rate(done), self.config
        gain_rate = factor * rate_at(config.exposure_lr, config.exposure_lr_final, done)
        for index, numbers in zip(indices, slopes, strict=False):
            if self.poses is not None and pose_rate:
                self.poses.learn(index, numbers[3:].astype(np.float32).reshape(4, 4), pose_rate)
            if self.gains is not None:
                self.gains.learn(index, numbers[:3], gain_rate)

    def arrays(self) -> dict[str, np.ndarray]:
        """State by name; no copies."""
        out: dict[str, np.ndarray] = {}
        for photo_parameters in (self.gains, self.poses, self.blurs, self.transients):
            if photo_parameters is not None:
                out |= photo_parameters.arrays()
        return out

    def restore(self, train: Sequence[int], views: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Restore the state that `arrays` returned; without gains or poses there, none are used.

        Raises:
            ValueError, KeyError: the arrays are invalid.
        """
        found = PhotoGains.are_in(arrays)
        fixed = self.gains is not None and self.gains.fixed
        self.gains = PhotoGains.restored(train, views, arrays, fixed=fixed) if found else None
        found = PhotoPoses.are_in(arrays)
        self.poses = PhotoPoses.restored(train, views, arrays) if found else None
        if self.blurs is not None:
            self.blurs.restore(arrays)
        if self.transients is not None:
            self.transients.restore(arrays)


def initial_poses(
    pose_check: PoseCheck, train: Sequence[int], frame: TrainingFrame
) -> PhotoPoses | None:
    """Initial poses in the training frame; None: the poses of the capture."""
    if pose_check.viewmats is None:
        return None
    return PhotoPoses(
        train,
        frame.similarity.viewmats_to_training(pose_check.viewmats),
        unit=frame.extent,
        learns=pose_check.learns,
    )
