"""Model argument of verbs: a splat file, the folder of a run with its options, or an LOD file."""

import argparse
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...config import Background, DataConfig, TrainConfig
from ...datasets import Dataset
from ...errors import ConfigError, DatasetError
from ...formats import SplatFile, is_splat_file, read_splat_file
from ...io.colmap.folder import find_model
from ...io.exposure_json import read_exposures
from ...io.files import check_regular, is_file
from ...io.missing_path import missing_path
from ...io.ply.comments import stated_near
from ...io.ply.splats import header_comments
from ...io.runs import options_of_run
from ...io.unsupported_formats import describe_unsupported
from ...lod.lod_renderer import LodModel
from ...photo_exposure import NEUTRAL, PhotoExposure
from ...quoting import as_typed, brief
from ...raster.api import Rendered, render, render_camera
from ...raster.gpu.choice import CPU, Chosen
from ...scene import Cameras, splat_near
from ...splats import Splats
from ..parser import add_option
from .data_options import with_data_options


@dataclass(frozen=True, kw_only=True)
class ModelArgument:
    """Splats and the options of their training."""

    run: Path | None
    """Folder of the run that contains the model, if any."""
    file: SplatFile
    """The file that was read."""
    data: DataConfig | None
    """Options of the run; None: not known."""
    train: TrainConfig | None
    """Options of the run; None: not known."""
    device: Chosen = CPU
    """The device that draws it."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences for the user."""
        return self.file.notes

    @property
    def splats(self) -> Splats:
        """The splats."""
        return self.file.splats

    @property
    def path(self) -> Path:
        """The file."""
        return self.file.path

    @property
    def origin(self) -> np.ndarray | None:
        """Local origin of its means, as `Cameras.origin`."""
        return self.file.origin

    def drawn_by(self, device: Chosen) -> "ModelArgument":
        """The same model on another device."""
        return replace(self, device=device)

    def about(self, origin: np.ndarray | None) -> "ModelArgument":
        """The same model relative to another local origin."""
        return replace(self, file=self.file.about(origin))

    def world_of(self, cameras: Cameras) -> Cameras:
        """Cameras of its capture, moved to the world of its splats."""
        return cameras.of_splats(self.file.of_capture(cameras.origin).origin)

    @property
    def antialias(self) -> bool:
        """Whether it was trained with opacity compensation, according to its file or run."""
        return self.file.antialiased or trained_antialiased(self.train)

    @property
    def background(self) -> tuple[float, float, float]:
        """Background colour in measurements."""
        return background_of(self.train)

    @cached_property
    def near(self) -> float:
        """Near plane of the training, world units; `splat_near` if unknown."""
        near = trained_near(self.file.comments, self.run, self.train)
        return splat_near(self.splats.means) if near is None else near

    @property
    def cameras(self) -> Cameras | None:
        """Cameras inside the file: None, as cameras.json is a separate file."""
        return None

    @property
    def count(self) -> int:
        """Number of splats."""
        return len(self.splats)

    def draw(
        self, K: np.ndarray, viewmat: np.ndarray, width: int, height: int, **how: Any
    ) -> Rendered:
        """Render a picture, as `gscore.render`."""
        how |= {"device": self.device, "keep": True}
        return render(self.splats, K, viewmat, width, height, **how)

    @cached_property
    def exposures(self) -> dict[str, PhotoExposure]:
        """Exposures of the run's photos, see `read_exposures`."""
        return read_exposures(self.run)

    def picture(
        self, cameras: Cameras, index: int, *, threads: int, mask_mode: str = "none"
    ) -> np.ndarray:
        """[H, W, 3] float32, the render at a camera with the exposure of its photo, as in
        measurements; a background behind `composite` masks is not exposed."""
        how = {"near": self.near, "antialias": self.antialias, "threads": threads}
        how |= {"device": self.device, "keep": True}
        exposure = self.exposures.get(cameras.names[index], NEUTRAL)
        background = self.background
        if mask_mode == "composite":
            background = exposure.behind(background)
        return exposure.apply(
            render_camera(self.splats, cameras, index, background=background, **how).rgb
        )


def trained_antialiased(train: TrainConfig | None) -> bool:
    """Whether a known training used opacity compensation."""
    return bool(train and train.antialias)


def background_of(train: TrainConfig | None) -> tuple[float, float, float]:
    """Background colour in measurements of a training; black if unknown."""
    is_white = train is not None and train.background is Background.WHITE
    return (1.0, 1.0, 1.0) if is_white else (0.0, 0.0, 0.0)


def trained_near(
    comments: Iterable[str], run: Path | None, train: TrainConfig | None
) -> float | None:
    """Near plane of a training, world units; None: unknown.

    Args:
        comments: Header comments of the splat file, where trainings state lowered near planes.
        run: Folder of the run, whose PLY states it for files of other formats.
        train: Options of the run.

    Raises:
        FormatError: A comment is malformed.
    """
    stated = stated_near(comments)
    if stated is None and run is not None and is_file(ply := run / "point_cloud.ply"):
        stated = stated_near(header_comments(ply))
    return stated if stated is not None or train is None else train.near


def add_model_argument(parser: argparse.ArgumentParser) -> None:
    """Declare the model as the first argument, or as `-m` of the 3DGS tools."""
    add_option(parser, "model?", "folder of a run, or a splat file", Path)
    add_option(
        parser, "-m, --model-path MODEL_OPTION", argparse.SUPPRESS, Path, dest="model_option"
    )


def model_path(args: argparse.Namespace) -> Path:
    """The path given for `add_model_argument`.

    Raises:
        ConfigError: No model, or two.
    """
    given = [path for path in (args.model, args.model_option) if path is not None]
    if len(given) != 1:
        raise ConfigError(
            "Give one model: the folder of a run, or a splat file."
            + (f" Got {brief(given[0])} and {brief(given[1])}." if given else "")
        )
    return given[0]


def open_model(path: Path) -> ModelArgument:
    """Read a splat file of any format, or the newest one in the folder of a run.

    Raises:
        DatasetError: There is no such file, or no model in the folder.
        FormatError: The file contains no splats.
        ConfigError: The run's config.json cannot be used.
    """
    found = find_splats(path)
    run = find_run(found)
    data, train = options_of_run(run / "config.json") if run else (None, None)
    return ModelArgument(file=read_splat_file(found), run=run, data=data, train=train)


def find_splats(path: Path) -> Path:
    """`path` if it is a file or an unpacked SOG; in other folders point_cloud.ply, else the PLY of
    the last iteration as in 3DGS.

    Raises:
        DatasetError: There is none.
    """
    if path.is_file():
        return path
    if path.is_dir() and is_splat_file(path):
        return path
    if not path.exists():
        raise DatasetError(
            missing_path(path, "file or folder", "Give a splat file or the folder of a run.")
        )
    if not path.is_dir():
        check_regular(path)
    found = path / "point_cloud.ply"
    if found.is_file():
        return found
    saved = sorted(path.glob("point_cloud/iteration_*/point_cloud.ply"), key=_iteration)
    if saved:
        return saved[-1]
    other = f"{path} is a capture; train it first: {as_typed('train', path, '-o', 'run')}"
    raise DatasetError(
        f"No model in {path}: expected point_cloud.ply or point_cloud/iteration_*/point_cloud.ply; "
        "give the file itself or the folder of a training. "
        + (other if is_capture(path) else describe_unsupported(path))
    )


def is_capture(folder: Path) -> bool:
    """Whether a folder contains photos with cameras."""
    try:
        find_model(folder)
    except DatasetError:
        return (folder / "transforms.json").is_file()
    return True


def _iteration(ply: Path) -> int:
    digits = re.search(r"\d+", ply.parent.name)
    return int(digits[0]) if digits else -1


def find_run(file: Path) -> Path | None:
    """The folder with the config.json of the file's run, or None."""
    folders = [file.parent]
    if file.parent.name.startswith("iteration_"):
        folders.append(file.parent.parent.parent)
    if file.parent.name == "snapshots":
        folders.append(file.parent.parent)
    return next((f for f in folders if (f / "config.json").is_file()), None)


@dataclass(frozen=True, kw_only=True)
class LodArgument:
    """A file of levels of detail, with the interface of `ModelArgument`."""

    model: LodModel
    lod_px: float
    """Allowed error, px."""
    most: int | None
    """Maximum number of rendered splats; None: no limit."""
    device: Chosen = CPU
    """The device that draws it."""
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

    def drawn_by(self, device: Chosen) -> "LodArgument":
        """The same model on another device."""
        return replace(self, device=device)

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
        how |= {"device": self.device}
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


def data_config_of(args: argparse.Namespace, model: ModelArgument) -> DataConfig:
    """Data options of the run, overridden by the command line; a PLY alone needs `-s`."""
    if model.data is not None:
        config = model.data
        if args.source is not None:
            config = DataConfig(
                source=args.source, resolution=config.resolution, max_width=config.max_width
            )
            # Names and folders of the old capture do not apply to another one. If the old one no
            # longer exists, it was moved here.
            if args.source.resolve() == model.data.source.resolve():
                config = model.data
            elif not model.data.source.exists():
                config = replace(model.data, source=args.source)
        elif not config.source.exists():
            raise DatasetError(
                f"The capture of {model.run}, {config.source}, no longer exists; give its current "
                "folder with -s SOURCE."
            )
    elif args.source is None:
        raise ConfigError(f"The capture of {model.path} is unknown; give it with -s SOURCE.")
    else:
        config = DataConfig(source=args.source, eval=True)
    return with_data_options(config, args)


def views_of(split: str | None, dataset: Dataset) -> tuple[str, list[int]]:
    """Name and indices of the views to measure."""
    if split == "test" and not dataset.test:
        raise DatasetError(
            "The run has no held-out views; choose another `--split`, or select test views with "
            "`--hold-out`."
        )
    if split == "test" or (split is None and dataset.test):
        return "test", dataset.test
    if split == "all":
        return "all", sorted([*dataset.train, *dataset.test])
    return "train", dataset.train
