"""One view after the other, drawn and differentiated without autograd and without allocating."""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from ..errors import GsError
from . import _native
from .calls import Picture, Settings, backward, check_splats, check_tiles, forward


class Painter:
    """Draws a view and gives gradients of it, in memory that is kept from call to call.

    So what `draw` and `radii` return is overwritten by the next `draw`.
    """

    def __init__(self) -> None:
        self._raster = _native.Raster()
        self._memory: dict[str, Tensor] = {}
        self._drawn: tuple[Sequence[Tensor], Settings] | None = None

    def draw(
        self,
        splats: Sequence[Tensor],
        viewmat: Tensor,
        K: Tensor,
        width: int,
        height: int,
        *,
        sh_degree: int | None = None,
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        near: float = 0.01,
        antialias: bool = False,
        inverse_depth: bool = False,
        threads: int = 0,
        disable: int = 0,
        tiles: Tensor | None = None,
    ) -> Picture:
        """Render raw splats; arguments and errors as for `rasterize`, `splats` in its order.

        Returns:
            rgb, alpha and, where asked for, inverse depth.
        """
        stored = check_splats(splats, viewmat)
        _native.check_size(width, height)
        tensors = [t.detach().contiguous() for t in splats]
        settings = Settings(
            raw=True,
            sh_degree=stored if sh_degree is None else sh_degree,
            width=width,
            height=height,
            K=K.numpy(),
            near=near,
            antialias=antialias,
            background=background,
            outputs=_native.OUT_INVERSE_DEPTH * inverse_depth,
            threads=threads,
            disable=disable,
            tiles=check_tiles(tiles, width, height),
        )
        picture = Picture(
            self._kept("rgb", (height, width, 3)),
            self._kept("alpha", (height, width)),
            self._kept("inverse_depth", (height, width)) if inverse_depth else None,
        )
        self._drawn = None
        radii = self._kept("radii", (len(tensors[0]),), torch.int32)
        forward(self._raster, tensors, viewmat.contiguous(), settings, picture, radii)
        self._drawn = tensors, settings
        return picture

    @property
    def radii(self) -> Tensor:
        """[N] int32 px: half the larger side of a splat's box in the last view, 0 = culled."""
        return self._memory["radii"]

    def gradients(
        self,
        into: Mapping[str, Tensor],
        rgb: Tensor,
        alpha: Tensor | None = None,
        inverse_depth: Tensor | None = None,
    ) -> Tensor:
        """Gradients of the last view.

        Args:
            into: Contiguous float32 tensors of the splats' shapes by name, which are overwritten;
                those of shN are added to.
            rgb: [H, W, 3], gradient of the loss in the picture.
            alpha: [H, W], as the next; None: zero.
            inverse_depth: Only where it was drawn.

        Returns:
            [N, 2], gradient in the projected means, px.

        Raises:
            GsError: nothing was drawn.
        """
        if self._drawn is None:
            raise GsError("There is no view to take gradients of: call draw first.")
        tensors, settings = self._drawn
        means2d = self._kept("means2d", (len(tensors[0]), 2))
        outputs = [None if v is None else v.contiguous() for v in (rgb, alpha, inverse_depth)]
        backward(
            self._raster,
            tensors,
            settings,
            [*outputs, None],
            {**into, "means2d": means2d},
            add_shN=True,
        )
        return means2d

    def release(self) -> None:
        """Give memory back: that of the library, which the next `draw` takes again, and the splats
        that were drawn, which may be about to be replaced."""
        self._drawn, self._raster = None, _native.Raster()

    def stats(self) -> dict[str, float]:
        """Counts and milliseconds by stage (gs_stats) of the last view and its gradients."""
        return self._raster.stats().as_dict()

    def _kept(
        self, name: str, shape: tuple[int, ...], dtype: torch.dtype = torch.float32
    ) -> Tensor:
        found = self._memory.get(name)
        if found is None or found.shape != shape:
            found = self._memory[name] = torch.empty(shape, dtype=dtype)
        return found
