"""3D Gaussian Splatting that trains and renders on any CPU.

Everything public is listed in `__all__` and loaded when first used: importing gscore costs a few
milliseconds and brings in neither torch nor the native library.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._version import __version__
from .extras import how_to_install, missing

if TYPE_CHECKING:
    from .config import PRESETS, Background, DataConfig, Strategy, Switch, TrainConfig
    from .datasets import Capture, Dataset, Folder, View, load_dataset, read_capture
    from .datasets.mattes import are_mattes
    from .datasets.resolution import target_size
    from .depth.stated import StatedDepth, stated_depth
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
        DepthDone,
        DepthProgress,
        Done,
        Estimated,
        Eval,
        Event,
        Failed,
        FrameStarted,
        Preview,
        Progress,
        Saved,
        SequenceDone,
        SfmDone,
        SfmProgress,
        Snapshot,
        Started,
        Warn,
        from_line,
        judged_psnr,
    )
    from .io.cameras_json import read_cameras
    from .io.colmap import find_model as find_colmap
    from .io.colmap import read_model as read_colmap
    from .io.colmap import write_model as write_colmap
    from .io.colmap_model import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints
    from .io.files import atomic_write
    from .io.image_header import ImageInfo, read_header
    from .io.ply import MIP_COMMENT, is_antialiased, read_splats, write_splats
    from .io.resample import downscale
    from .io.runs import RunInfo, clear_run, read_run
    from .io.sequences import SequenceIndex, read_sequence
    from .metrics.colormap import colorize
    from .metrics.image import psnr
    from .options import Option, options_of
    from .raster.api import Rendered, render
    from .raster.autograd import RasterAux, RasterOutput, rasterize
    from .raster.backend import CancelFlag
    from .raster.loss import ImageLoss, image_loss
    from .scene import Cameras, PointCloud, Scene
    from .sequence_options import SequenceOptions
    from .sh import sh0_to_rgb
    from .splats import Splats
    from .trainer.estimate.forecast import Estimate, estimate
    from .trainer.run import train
    from .trainer.sequence import train_sequence
    from .transforms import rotmat_to_quat, transform_splats

# Where a public name lives; `module:name` where it is called differently there.
_HOME = {
    "BackendError": "errors",
    "Background": "config",
    "Cameras": "scene",
    "CancelFlag": "raster.backend",
    "Cancelled": "errors",
    "Capture": "datasets",
    "ColmapCamera": "io.colmap_model",
    "ColmapImage": "io.colmap_model",
    "ColmapModel": "io.colmap_model",
    "ColmapPoints": "io.colmap_model",
    "ConfigError": "errors",
    "DataConfig": "config",
    "Dataset": "datasets",
    "DatasetError": "errors",
    "DepthDone": "events",
    "DepthProgress": "events",
    "Done": "events",
    "Estimate": "trainer.estimate.forecast",
    "Estimated": "events",
    "Eval": "events",
    "Event": "events",
    "Failed": "events",
    "Folder": "datasets",
    "FormatError": "errors",
    "FrameStarted": "events",
    "GsError": "errors",
    "ImageInfo": "io.image_header",
    "ImageLoss": "raster.loss",
    "MIP_COMMENT": "io.ply",
    "Option": "options",
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
    "SequenceDone": "events",
    "SfmDone": "events",
    "SfmProgress": "events",
    "SequenceIndex": "io.sequences",
    "SequenceOptions": "sequence_options",
    "ShapeError": "errors",
    "Snapshot": "events",
    "Splats": "splats",
    "Started": "events",
    "StatedDepth": "depth.stated",
    "Strategy": "config",
    "Switch": "config",
    "TrainConfig": "config",
    "View": "datasets",
    "Warn": "events",
    "are_mattes": "datasets.mattes",
    "atomic_write": "io.files",
    "clear_run": "io.runs",
    "colorize": "metrics.colormap",
    "downscale": "io.resample",
    "estimate": "trainer.estimate.forecast",
    "find_colmap": "io.colmap:find_model",
    "from_line": "events",
    "judged_psnr": "events",
    "image_loss": "raster.loss",
    "is_antialiased": "io.ply",
    "load_dataset": "datasets",
    "options_of": "options",
    "psnr": "metrics.image",
    "rasterize": "raster.autograd",
    "read_cameras": "io.cameras_json",
    "read_capture": "datasets",
    "read_colmap": "io.colmap:read_model",
    "read_header": "io.image_header",
    "read_run": "io.runs",
    "read_sequence": "io.sequences",
    "read_splats": "io.ply",
    "render": "raster.api",
    "rotmat_to_quat": "transforms",
    "sh0_to_rgb": "sh",
    "stated_depth": "depth.stated",
    "target_size": "datasets.resolution",
    "train": "trainer.run",
    "train_sequence": "trainer.sequence",
    "transform_splats": "transforms",
    "write_colmap": "io.colmap:write_model",
    "write_splats": "io.ply",
}

__all__ = [
    "MIP_COMMENT",
    "PRESETS",
    "BackendError",
    "Background",
    "Cameras",
    "CancelFlag",
    "Cancelled",
    "Capture",
    "ColmapCamera",
    "ColmapImage",
    "ColmapModel",
    "ColmapPoints",
    "ConfigError",
    "DataConfig",
    "Dataset",
    "DatasetError",
    "DepthDone",
    "DepthProgress",
    "Done",
    "Estimate",
    "Estimated",
    "Eval",
    "Event",
    "Failed",
    "Folder",
    "FormatError",
    "FrameStarted",
    "GsError",
    "ImageInfo",
    "ImageLoss",
    "Option",
    "PointCloud",
    "Preview",
    "Progress",
    "RasterAux",
    "RasterOutput",
    "Rendered",
    "RunInfo",
    "Saved",
    "Scene",
    "SequenceDone",
    "SequenceIndex",
    "SequenceOptions",
    "SfmDone",
    "SfmProgress",
    "ShapeError",
    "Snapshot",
    "Splats",
    "Started",
    "StatedDepth",
    "Strategy",
    "Switch",
    "TrainConfig",
    "View",
    "Warn",
    "__version__",
    "are_mattes",
    "atomic_write",
    "clear_run",
    "colorize",
    "downscale",
    "estimate",
    "find_colmap",
    "from_line",
    "image_loss",
    "is_antialiased",
    "judged_psnr",
    "load_dataset",
    "options_of",
    "psnr",
    "rasterize",
    "read_cameras",
    "read_capture",
    "read_colmap",
    "read_header",
    "read_run",
    "read_sequence",
    "read_splats",
    "render",
    "rotmat_to_quat",
    "sh0_to_rgb",
    "stated_depth",
    "target_size",
    "train",
    "train_sequence",
    "transform_splats",
    "write_colmap",
    "write_splats",
]


def __getattr__(name: str) -> Any:
    home = _HOME.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, inner = home.partition(":")
    try:
        return getattr(import_module(f".{module}", __name__), inner or name)
    except ModuleNotFoundError as error:
        needed = error.name or ""
        if not how_to_install(needed):
            raise
        sentence = missing(needed, f"gscore.{name}")
        raise ModuleNotFoundError(sentence, name=error.name) from error


def __dir__() -> list[str]:
    return __all__
