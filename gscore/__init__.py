"""3D Gaussian Splatting that trains and renders on any CPU.

Everything public is listed in `__all__` and loaded when first used: importing gscore costs a few
milliseconds and brings in neither torch nor the native library.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._version import __version__

if TYPE_CHECKING:
    from .config import DataConfig, TrainConfig
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
    from .io.ply import read_splats, write_splats
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
    "FormatError": "errors",
    "GsError": "errors",
    "ImageLoss": "raster.loss",
    "PointCloud": "scene",
    "RasterAux": "raster.autograd",
    "RasterOutput": "raster.autograd",
    "Rendered": "raster.api",
    "Scene": "scene",
    "ShapeError": "errors",
    "Splats": "splats",
    "TrainConfig": "config",
    "image_loss": "raster.loss",
    "load_dataset": "datasets",
    "rasterize": "raster.autograd",
    "read_splats": "io.ply",
    "render": "raster.api",
    "train": "trainer",
    "write_splats": "io.ply",
}

__all__ = [
    "BackendError",
    "Cameras",
    "CancelFlag",
    "Cancelled",
    "ConfigError",
    "DataConfig",
    "Dataset",
    "DatasetError",
    "FormatError",
    "GsError",
    "ImageLoss",
    "PointCloud",
    "RasterAux",
    "RasterOutput",
    "Rendered",
    "Scene",
    "ShapeError",
    "Splats",
    "TrainConfig",
    "__version__",
    "image_loss",
    "load_dataset",
    "rasterize",
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
