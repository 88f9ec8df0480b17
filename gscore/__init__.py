"""3D Gaussian Splatting that trains and renders on any CPU.

Everything public is listed in `__all__` and loaded when first used: importing gscore costs a few
milliseconds and brings in neither torch nor the native library.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._version import __version__

if TYPE_CHECKING:
    from .config import PRESETS, DataConfig, Strategy, TrainConfig
    from .datasets import Dataset, load_dataset
    from .errors import (
        BackendError,
        Cancelled,
        ConfigError,
        DatasetError,
        FormatError,
        GsError,
        ShapeError,
    )
    from .events import (
        Done,
        Eval,
        Event,
        Failed,
        Preview,
        Progress,
        Saved,
        Snapshot,
        Started,
        Warn,
        from_line,
    )
    from .io.ply import read_splats, write_splats
    from .io.runs import RunInfo, clear_run, read_run
    from .raster.api import Rendered, render
    from .raster.autograd import RasterAux, RasterOutput, rasterize
    from .raster.backend import CancelFlag
    from .raster.loss import ImageLoss, image_loss
    from .scene import Cameras, PointCloud, Scene
    from .splats import Splats
    from .trainer import train

_HOME = {
    "BackendError": "errors",
    "Cameras": "scene",
    "CancelFlag": "raster.backend",
    "Cancelled": "errors",
    "ConfigError": "errors",
    "DataConfig": "config",
    "Dataset": "datasets",
    "DatasetError": "errors",
    "Done": "events",
    "Eval": "events",
    "Event": "events",
    "Failed": "events",
    "FormatError": "errors",
    "GsError": "errors",
    "ImageLoss": "raster.loss",
    "PRESETS": "config",
    "PointCloud": "scene",
    "Preview": "events",
    "Progress": "events",
    "RasterAux": "raster.autograd",
    "RasterOutput": "raster.autograd",
    "Rendered": "raster.api",
    "RunInfo": "io.runs",
    "Saved": "events",
    "Scene": "scene",
    "ShapeError": "errors",
    "Snapshot": "events",
    "Splats": "splats",
    "Started": "events",
    "Strategy": "config",
    "TrainConfig": "config",
    "Warn": "events",
    "clear_run": "io.runs",
    "from_line": "events",
    "image_loss": "raster.loss",
    "load_dataset": "datasets",
    "rasterize": "raster.autograd",
    "read_run": "io.runs",
    "read_splats": "io.ply",
    "render": "raster.api",
    "train": "trainer",
    "write_splats": "io.ply",
}

__all__ = [
    "PRESETS",
    "BackendError",
    "Cameras",
    "CancelFlag",
    "Cancelled",
    "ConfigError",
    "DataConfig",
    "Dataset",
    "DatasetError",
    "Done",
    "Eval",
    "Event",
    "Failed",
    "FormatError",
    "GsError",
    "ImageLoss",
    "PointCloud",
    "Preview",
    "Progress",
    "RasterAux",
    "RasterOutput",
    "Rendered",
    "RunInfo",
    "Saved",
    "Scene",
    "ShapeError",
    "Snapshot",
    "Splats",
    "Started",
    "Strategy",
    "TrainConfig",
    "Warn",
    "__version__",
    "clear_run",
    "from_line",
    "image_loss",
    "load_dataset",
    "rasterize",
    "read_run",
    "read_splats",
    "render",
    "train",
    "write_splats",
]


def __getattr__(name: str) -> Any:
    home = _HOME.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{home}", __name__), name)


def __dir__() -> list[str]:
    return __all__
