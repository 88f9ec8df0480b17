"""Training rasterizer: forward and backward of successive views without autograd or allocation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..errors import GsError
from ..splats import PARAMETERS
from . import _native, arguments, header
from .blend_weights import GEOMETRY, blending_weights
from .memory import empty, zeros
from .request import Frustum, Settings


@dataclass
class Picture:
    """A rendered view; fields that were not requested are None."""

    rgb: Tensor
    """[H, W, 3]."""
    alpha: Tensor
    """[H, W]."""
    inverse_depth: Tensor | None = None
    """[H, W], sum of weight / z, not divided by alpha."""


class TrainingRasterizer:
    """Renders a view and computes its gradients, in memory reused from call to call.

    The results of `draw` and `radii` are overwritten by the next `draw`. Frozen splats are drawn
    before those of a call; radii, gradients and weights are those of the latter only.
    """

    def __init__(self, frozen: Mapping[str, Tensor] | None = None) -> None:
        """`frozen`: raw parameters of frozen splats, whose SH degree may be lower; None: none."""
        self._first = 0 if frozen is None else len(frozen["means"])
        self._frozen = frozen if self._first else None
        """Row of the first splat that is not frozen."""
        self._joined: dict[str, Tensor] = {}
        self._room: dict[str, Tensor] = {}
        """Gradients of all splats, if some are frozen."""
        self._raster = _native.Raster()
        self._memory: dict[str, Tensor] = {}
        self._drawn: tuple[Sequence[Tensor], Frustum, Settings] | None = None

    def draw(
        self, splats: Sequence[Tensor], view: Frustum, settings: Settings | None = None
    ) -> Picture:
        """Render splats, which need not be contiguous; errors are those of `rasterize`.

        Args:
            splats: `PARAMETERS`, in their order.
            view: Camera and picture size.
            settings: Render settings; the only optional output is inverse depth.

        Returns:
            rgb, alpha and, if requested, inverse depth.
        """
        settings = settings or Settings()
        arguments.check_size(view.width, view.height)
        size = (view.height, view.width)
        tensors = [self._whole(*pair) for pair in zip(PARAMETERS, splats, strict=True)]
        pictures = {"rgb": self._kept("rgb", (*size, 3)), "alpha": self._kept("alpha", size)}
        if settings.outputs & header.OUT_INVERSE_DEPTH:
            pictures["inverse_depth"] = self._kept("inverse_depth", size)
        radii = self._kept("radii", (len(tensors[0]),), torch.int32)
        self._drawn = None
        self._raster.forward(tensors, view, settings, pictures | {"radii": radii})
        self._drawn = tensors, view, settings
        return Picture(**pictures)

    @property
    def radii(self) -> Tensor:
        """[N] int32 px: half the larger side of a splat's box in the last view, 0 = culled."""
        return self._memory["radii"][self._first :]

    def gradients(
        self,
        into: Mapping[str, Tensor],
        rgb: Tensor,
        alpha: Tensor | None = None,
        inverse_depth: Tensor | None = None,
        *,
        viewmat: Tensor | None = None,
    ) -> Tensor:
        """Gradients of the last view.

        Args:
            into: Contiguous float32 tensors of the splats' shapes by name, which are overwritten;
                shN is accumulated.
            rgb: [H, W, 3], gradient of the loss in the picture.
            alpha: [H, W], gradient in alpha; None: zero.
            inverse_depth: [H, W], gradient in inverse depth, only if it was rendered; None: zero.
            viewmat: [4, 4] float32, receives the gradient in viewmat; None: not computed.

        Returns:
            [N, 2], gradient in the projected means, px.

        Raises:
            GsError: `draw` was not called.
        """
        if self._drawn is None:
            raise GsError("There is no view to take gradients of: call draw first.")
        splats, view, settings = self._drawn
        means2d, whole = self._kept("means2d", (len(splats[0]), 2)), self._whole_gradients(into)
        if self._first:
            whole["shN"][self._first :] = into["shN"]
        v_pictures = {"rgb": rgb, "alpha": alpha, "inverse_depth": inverse_depth}
        self._raster.backward(
            splats,
            view,
            settings,
            {name: None if v is None else v.contiguous() for name, v in v_pictures.items()},
            {**whole, "means2d": means2d} | ({} if viewmat is None else {"viewmat": viewmat}),
            add_shN=True,
        )
        for name, grad in into.items() if self._first else ():
            grad.copy_(whole[name][self._first :])
        return means2d[self._first :]

    def weights(
        self,
        splats: Mapping[str, Tensor],
        view: Frustum,
        settings: Settings,
        shares: Tensor,
        scratch: Mapping[str, Tensor],
    ) -> np.ndarray:
        """`blending_weights` of splats by name, without their SH coefficients, in the memory of
        this rasterizer; its last view is lost."""
        self._drawn = None
        geometry = [self._whole(name, splats[name]) for name in GEOMETRY]
        whole = self._whole_gradients(scratch)
        return blending_weights(
            geometry, view, settings, shares, scratch=whole, raster=self._raster
        )[self._first :]

    def release(self) -> None:
        """Free memory: the library's workspace, which the next `draw` allocates again, and the
        reference to the last splats, which may be about to be replaced."""
        self._drawn, self._raster, self._room = None, _native.Raster(), {}

    def stats(self) -> dict[str, float]:
        """Counts and milliseconds by stage (gs_stats) of the last view and its gradients."""
        return self._raster.stats()

    def _whole(self, name: str, splats: Tensor) -> Tensor:
        """A parameter of the frozen splats followed by `splats`; valid until the next call."""
        if self._frozen is None:
            return splats.detach().contiguous()
        shape = (self._first + len(splats), *splats.shape[1:])
        found = self._joined.get(name)
        if found is None or found.shape != shape:
            found, frozen = empty(*shape), self._frozen[name]
            self._joined[name] = found
            found[: self._first] = 0
            if frozen.numel():
                # SH bands that the frozen splats lack stay zero.
                found[: self._first][tuple(slice(n) for n in frozen.shape)] = frozen
        found[self._first :] = splats.detach()
        return found

    def _whole_gradients(self, into: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        """Room for gradients of all splats; `into` itself if none is frozen."""
        if self._frozen is None:
            return into
        for name, grad in into.items():
            shape = (self._first + len(grad), *grad.shape[1:])
            if name not in self._room or self._room[name].shape != shape:
                self._room[name] = zeros(*shape)
        return {name: self._room[name] for name in into}

    def _kept(
        self, name: str, shape: tuple[int, ...], dtype: torch.dtype = torch.float32
    ) -> Tensor:
        found = self._memory.get(name)
        if found is None or found.shape != shape:
            found = self._memory[name] = empty(*shape, dtype=dtype)
        return found
