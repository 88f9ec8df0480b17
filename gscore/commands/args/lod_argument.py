"""LOD argument of verbs: a file of levels of detail, rendered from disk or loaded as splats."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...config import DataConfig
from ...lod.lod_renderer import LodModel
from ...raster.api import Rendered
from ...scene import Cameras


@dataclass(frozen=True, kw_only=True)
class LodArgument:
    """A file of levels of detail, with the interface of `ModelArgument`."""

    model: LodModel
    lod_px: float
    """Allowed error, px."""
    most: int | None
    """Maximum number of rendered splats; None: no limit."""
    run: None = None
    data: DataConfig | None = None
    warnings: tuple[str, ...] = ()

    @property
    def path(self) -> Path:
        """The file."""
        return self.model.file.path

    @property
    def antialias(self) -> bool:
        """Whether it was trained with opacity compensation."""
        return self.model.index.antialias

    @property
    def background(self) -> tuple[float, float, float]:
        """Background colour in measurements."""
        return self.model.index.background

    @property
    def near(self) -> float:
        """Near plane of the training, world units."""
        return self.model.index.near

    @property
    def cameras(self) -> Cameras | None:
        """Cameras of its run; None: not known."""
        return self.model.index.cameras

    @property
    def origin(self) -> np.ndarray | None:
        """Local origin of its means, as `Cameras.origin`."""
        return self.model.index.origin

    def world_of(self, cameras: Cameras) -> Cameras:
        """Cameras of its capture, moved to the world of its splats."""
        return cameras.of_splats(self.origin)

    @property
    def count(self) -> int:
        """Splats of the finest level."""
        return self.model.index.levels[0].splats

    def draw(
        self, K: np.ndarray, viewmat: np.ndarray, width: int, height: int, **how: Any
    ) -> Rendered:
        """Render a picture, as `LodModel.render`."""
        return self.model.render(
            K, viewmat, width, height, lod_px=self.lod_px, most=self.most, **how
        )

    def drawn(self) -> dict[str, Any]:
        """Splats and chunks of the last picture, as JSON values."""
        chosen = self.model.chosen
        if chosen is None:
            return {}
        levels = chosen.by_level(len(self.model.index.levels))
        return {"splats_drawn": chosen.splats, "chunks_by_level": levels, "lod_px": chosen.pixels}
