"""3D Gaussian Splatting that trains and renders on any CPU.

`__all__` is the interface of scripts, `gscore.frontend` the additional one of front ends. Both load
a name on first use: importing gscore takes a few milliseconds and loads neither torch nor the
native library.
"""

from ._version import __version__

TYPE_CHECKING = False  # type checkers know the name; importing typing takes milliseconds
if TYPE_CHECKING:
    from typing import Any

    from .config import Background, DataConfig, Strategy, TrainConfig
    from .control import Control
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
    from .events import Event, headline_psnr
    from .formats import read_splat_file, read_splats, write_splat_file
    from .io.ply.splats import write_splats
    from .metrics.image import psnr
    from .presets import PRESETS
    from .raster.api import Rendered, render
    from .raster.autograd import RasterAux, RasterOutput, rasterize
    from .raster.loss import ImageLoss, image_loss
    from .raster.native_library import CancelFlag
    from .scene import Cameras, PointCloud, Scene
    from .sequence_options import SequenceOptions
    from .splats import Splats
    from .trainer.files.run_result import TrainResult
    from .trainer.run import train
    from .trainer.sequence import train_sequence
    from .transforms import transform_splats

_HOME = {
    "BackendError": "errors",
    "Background": "config",
    "Cameras": "scene",
    "CancelFlag": "raster.native_library",
    "Cancelled": "errors",
    "ConfigError": "errors",
    "Control": "control",
    "DataConfig": "config",
    "Dataset": "datasets",
    "DatasetError": "errors",
    "Event": "events",
    "FormatError": "errors",
    "GsError": "errors",
    "ImageLoss": "raster.loss",
    "PRESETS": "presets",
    "PointCloud": "scene",
    "RasterAux": "raster.autograd",
    "RasterOutput": "raster.autograd",
    "Rendered": "raster.api",
    "Scene": "scene",
    "SequenceOptions": "sequence_options",
    "ShapeError": "errors",
    "Splats": "splats",
    "Strategy": "config",
    "TrainConfig": "config",
    "TrainResult": "trainer.files.run_result",
    "image_loss": "raster.loss",
    "headline_psnr": "events",
    "load_dataset": "datasets",
    "psnr": "metrics.image",
    "rasterize": "raster.autograd",
    "read_splat_file": "formats",
    "read_splats": "formats",
    "render": "raster.api",
    "train": "trainer.run",
    "train_sequence": "trainer.sequence",
    "transform_splats": "transforms",
    "write_splat_file": "formats",
    "write_splats": "io.ply.splats",
}
"""Module of each public name."""

__all__ = [
    "PRESETS",
    "BackendError",
    "Background",
    "Cameras",
    "CancelFlag",
    "Cancelled",
    "ConfigError",
    "Control",
    "DataConfig",
    "Dataset",
    "DatasetError",
    "Event",
    "FormatError",
    "GsError",
    "ImageLoss",
    "PointCloud",
    "RasterAux",
    "RasterOutput",
    "Rendered",
    "Scene",
    "SequenceOptions",
    "ShapeError",
    "Splats",
    "Strategy",
    "TrainConfig",
    "TrainResult",
    "__version__",
    "headline_psnr",
    "image_loss",
    "load_dataset",
    "psnr",
    "rasterize",
    "read_splat_file",
    "read_splats",
    "render",
    "train",
    "train_sequence",
    "transform_splats",
    "write_splat_file",
    "write_splats",
]


def __getattr__(name: str) -> "Any":
    from .extras import offered

    return offered(__name__, name, _HOME)


def __dir__() -> list[str]:
    return __all__
