"""Guide loss: distance of splats from the surface mesh."""

import torch

from ..depth.loss import l1_loss
from ..depth.targets import DepthTargets


class GuideLoss:
    """The depth loss of a guide, at one weight from the first step to the last.

    It counts on both sides of the surface. A loss that left alone what is nearer, as it may stand
    before the mesh, was tried: splats close to cameras then make up for what is missing behind
    them, and nothing pulls them back.
    """

    def __init__(self, targets: DepthTargets, *, weight: float, scale: float) -> None:
        """`scale`: training units a world unit."""
        self.targets = targets
        self._weight = weight
        self._unit = targets.unit / scale

    def weight(self, index: int) -> float:
        """What the loss of view `index` is multiplied by; 0: no inverse depth is needed."""
        return self._weight if index in self.targets else 0.0

    def __call__(
        self, index: int, inverse_depth: torch.Tensor, alpha: torch.Tensor
    ) -> torch.Tensor:
        """The loss of view `index`, without its weight; arguments as those of `DepthLoss`."""
        height, width = inverse_depth.shape
        target = self.targets.at(index, width, height)
        if target is None:
            return inverse_depth.new_zeros(())
        return l1_loss(inverse_depth, alpha, target, unit=self._unit)
