"""Frozen splats: rendered together with the trained splats, but not trained."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from torch import Tensor

from ...config import TrainConfig
from ...errors import ConfigError
from ...raster.memory import empty, zeros
from ...raster.request import Frustum, Settings
from ...raster.training_rasterizer import Picture, TrainingRasterizer
from ...splats import PARAMETERS, SH_REST_BY_DEGREE, Splats
from ...text_format import number
from ...transforms import Similarity
from ..model.conversion import tensors_from_splats
from ..model.initial_splats import check_splat_count
from ..model.training_frame import TrainingFrame
from .region_box import RegionBox


class FrozenSplats:
    """Frozen splats around a region, in COLMAP world as given, and in the training frame."""

    def __init__(self, world: Splats, similarity: Similarity) -> None:
        self.world = world
        """The splats as given, COLMAP world; written unchanged."""
        self._tensors = tensors_from_splats(similarity.splats_to_training(world))
        self._joined: dict[str, Tensor] = {}

    def __len__(self) -> int:
        return len(self.world)

    def content_hash(self) -> str:
        """Short hash of all parameters."""
        digest = hashlib.sha256()
        for name in PARAMETERS:
            digest.update(np.ascontiguousarray(getattr(self.world, name)).data)
        return digest.hexdigest()[:16]

    def parts(self, rows: int, sh_degree: int) -> Iterator[Splats]:
        """Yield the splats as given, in parts of at most `rows`, zero-padded to `sh_degree`."""
        count = SH_REST_BY_DEGREE[sh_degree]
        for at in range(0, len(self), rows):
            part = {name: getattr(self.world, name)[at : at + rows] for name in PARAMETERS}
            missing = count - part["shN"].shape[1]
            part["shN"] = np.pad(part["shN"], ((0, 0), (0, missing), (0, 0)))
            yield Splats(**part)

    def before(self, params: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the frozen splats followed by the raw `params`; valid until the next call."""
        return {name: self._with(name, p.detach()) for name, p in params.items()}

    def _with(self, name: str, trained: Tensor) -> Tensor:
        shape = (len(self) + len(trained), *trained.shape[1:])
        found = self._joined.get(name)
        if found is None or found.shape != shape:
            found = self._joined[name] = empty(*shape)
            frozen = self._tensors[name]
            found[: len(self)] = 0
            if frozen.numel():
                # SH bands that the frozen splats lack stay zero.
                found[: len(self)][tuple(slice(n) for n in frozen.shape)] = frozen
        found[len(self) :] = trained
        return found


def split_frozen(
    start: Splats, box: RegionBox, config: TrainConfig, frame: TrainingFrame
) -> tuple[Splats, FrozenSplats | None]:
    """Split start splats (world) into those in `box` (world) and the frozen ones around it, or
    None without any around it.

    Raises:
        ConfigError: none is in the box, there are more than `max_splats`, or their SH degree is
            above that of the run.
    """
    check_splat_count(start, config)
    inside = box.contains(start.means)
    if not inside.any():
        raise ConfigError(
            f"None of the {number(len(start))} splats of {config.start_splats} is in the region "
            f"{config.region}. Check that the box is in the capture's world."
        )
    if start.sh_degree > config.sh_degree:
        raise ConfigError(
            f"The frozen splats around the region have SH degree {start.sh_degree}, and this run "
            f"has {config.sh_degree}; use `--sh-degree {start.sh_degree}`."
        )
    if inside.all():
        return start, None
    return start.subset(inside), FrozenSplats(start.subset(~inside), frame.similarity)


class FrozenRasterizer(TrainingRasterizer):
    """A rasterizer for the splats of a region that renders the frozen splats with them.

    Radii, gradients and weights are those of the region's splats only.
    """

    def __init__(self, frozen: FrozenSplats) -> None:
        super().__init__()
        self._frozen = frozen
        self._into: dict[str, Tensor] = {}

    def draw(
        self, splats: Sequence[Tensor], view: Frustum, settings: Settings | None = None
    ) -> Picture:
        """As `TrainingRasterizer.draw`, with the frozen splats."""
        named: dict[str, Tensor] = dict(zip(PARAMETERS, splats, strict=True))
        return super().draw(tuple(self._frozen.before(named).values()), view, settings)

    @property
    def radii(self) -> Tensor:
        """[N] int32 px, as `TrainingRasterizer.radii`."""
        return super().radii[len(self._frozen) :]

    def gradients(
        self,
        into: Mapping[str, Tensor],
        rgb: Tensor,
        alpha: Tensor | None = None,
        inverse_depth: Tensor | None = None,
        *,
        viewmat: Tensor | None = None,
    ) -> Tensor:
        """As `TrainingRasterizer.gradients`."""
        count = len(self._frozen)
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
        """As `TrainingRasterizer.weights`."""
        room = {name: self._room(name, grad) for name, grad in scratch.items()}
        found = super().weights(self._frozen.before(splats), view, settings, shares, room)
        return found[len(self._frozen) :]

    def release(self) -> None:
        """As `TrainingRasterizer.release`."""
        super().release()
        self._into = {}

    def _room(self, name: str, like: Tensor) -> Tensor:
        shape = (len(self._frozen) + len(like), *like.shape[1:])
        found = self._into.get(name)
        if found is None or found.shape != shape:
            found = self._into[name] = zeros(*shape)
        return found
