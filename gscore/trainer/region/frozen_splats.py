"""Frozen splats: rendered together with the trained splats, but not trained."""

import hashlib
from collections.abc import Iterator

import numpy as np

from ...config import TrainConfig
from ...errors import ConfigError
from ...splats import PARAMETERS, SH_REST_BY_DEGREE, Splats
from ...text_format import number
from ...transforms import Similarity
from ..model.initial_splats import check_splat_count
from ..model.training_frame import TrainingFrame
from .region_photos import RegionBox


class FrozenSplats:
    """Frozen splats around a region, in COLMAP world as given, and in the training frame."""

    def __init__(self, world: Splats, similarity: Similarity) -> None:
        self.world = world
        """The splats as given, COLMAP world; written unchanged."""
        moved = similarity.splats_to_training(world)
        self.columns = {name: getattr(moved, name) for name in PARAMETERS}
        """Raw parameters, training frame."""

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
