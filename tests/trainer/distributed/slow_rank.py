"""Run as a slow rank: gscore with a pause in each rasterization."""

import sys
import time
from typing import Any

from gscore.commands import main
from gscore.raster.training_rasterizer import TrainingRasterizer

PAUSE = 0.5


def slow_down() -> None:
    """Make rasterization slower from now on."""
    draw = TrainingRasterizer.draw

    def slowly(*arguments: Any, **options: Any) -> Any:
        time.sleep(PAUSE)
        return draw(*arguments, **options)

    TrainingRasterizer.draw = slowly  # pyright: ignore[reportAttributeAccessIssue]


if __name__ == "__main__":
    slow_down()
    sys.exit(main(sys.argv[1:]))
