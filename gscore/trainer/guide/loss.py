"""Guide loss: distance of splats from the surface mesh."""

import torch

from ..depth.loss import l1_loss
from ..depth.targets import DepthTargets


class GuideLoss:
    """Depth loss of a surface mesh, with a constant weight.

    It acts on both sides of the surface. Without a term for splats in front of the mesh, splats
    close to cameras compensated for missing opacity behind them, and no gradient pulled them back.
    """

    def __init__(self, targets: DepthTargets, *, weight: float, scale: float) -> None:
        """`scale`: training units per world unit."""
        self.targets = targets
        self._weight = weight
        self._unit = targets.unit / scale

    def weight(self, index: int) -> float:
        """Weight of the loss of view `index`; 0: no inverse depth is needed."""
        return self._weight if index in self.targets else 0.0

    def __call__(
        self, index: int, inverse_depth: torch.Tensor, alpha: torch.Tensor
    ) -> torch.Tensor:
        """The loss of view `index`, without its weight; arguments as for `DepthLoss`."""
        height, width = inverse_depth.shape
        target = self.targets.at(index, width, height)
        if target is None:
            return inverse_depth.new_zeros(())
        return l1_loss(inverse_depth, alpha, target, unit=self._unit)
