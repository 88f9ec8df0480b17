"""Frozen rasterizer: draws splats that are not trained with those that are."""

from collections.abc import Mapping, Sequence

import numpy as np
from torch import Tensor

from ...raster.memory import empty, zeros
from ...raster.request import Frustum, Settings
from ...raster.training_rasterizer import Picture, TrainingRasterizer
from ...splats import PARAMETERS


class FrozenRasterizer(TrainingRasterizer):
    """A rasterizer for the splats of a region that renders the frozen splats with them.

    Radii, gradients and weights are those of the region's splats only.
    """

    def __init__(self, frozen: Mapping[str, Tensor]) -> None:
        """`frozen`: raw parameters."""
        super().__init__()
        self._frozen = frozen
        self._count = len(frozen["means"])
        self._joined: dict[str, Tensor] = {}
        self._into: dict[str, Tensor] = {}

    def draw(
        self, splats: Sequence[Tensor], view: Frustum, settings: Settings | None = None
    ) -> Picture:
        """Like `TrainingRasterizer.draw`, with the frozen splats."""
        named: dict[str, Tensor] = dict(zip(PARAMETERS, splats, strict=True))
        return super().draw(tuple(self._before(named).values()), view, settings)

    @property
    def radii(self) -> Tensor:
        """[N] int32 px, as `TrainingRasterizer.radii`."""
        return super().radii[self._count :]

    def gradients(
        self,
        into: Mapping[str, Tensor],
        rgb: Tensor,
        alpha: Tensor | None = None,
        inverse_depth: Tensor | None = None,
        *,
        viewmat: Tensor | None = None,
    ) -> Tensor:
        """Like `TrainingRasterizer.gradients`."""
        count = self._count
        room = {name: self._room(name, grad) for name, grad in into.items()}
        room["shN"][count:] = into["shN"]  # gradients of shN accumulate
        means2d = super().gradients(room, rgb, alpha, inverse_depth, viewmat=viewmat)
        for name, grad in into.items():
            grad.copy_(room[name][count:])
        return means2d[count:]

    def weights(
        self,
        splats: Mapping[str, Tensor],
        view: Frustum,
        settings: Settings,
        shares: Tensor,
        scratch: Mapping[str, Tensor],
    ) -> np.ndarray:
        """Like `TrainingRasterizer.weights`."""
        room = {name: self._room(name, grad) for name, grad in scratch.items()}
        found = super().weights(self._before(splats), view, settings, shares, room)
        return found[self._count :]

    def release(self) -> None:
        """Like `TrainingRasterizer.release`."""
        super().release()
        self._into = {}

    def _room(self, name: str, like: Tensor) -> Tensor:
        shape = (self._count + len(like), *like.shape[1:])
        found = self._into.get(name)
        if found is None or found.shape != shape:
            found = self._into[name] = zeros(*shape)
        return found

    def _before(self, params: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the frozen splats followed by the raw `params`; valid until the next call."""
        return {name: self._with(name, p.detach()) for name, p in params.items()}

    def _with(self, name: str, trained: Tensor) -> Tensor:
        shape = (self._count + len(trained), *trained.shape[1:])
        found = self._joined.get(name)
        if found is None or found.shape != shape:
            found = self._joined[name] = empty(*shape)
            frozen = self._frozen[name]
            found[: self._count] = 0
            if frozen.numel():
                # SH bands that the frozen splats lack stay zero.
                found[: self._count][tuple(slice(n) for n in frozen.shape)] = frozen
        found[self._count :] = trained
        return found
