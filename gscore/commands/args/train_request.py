"""Train request: the arguments of `gscore train` and `gscore sequence` as typed values."""

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ...config import LIFTED_BY, DataConfig, TrainConfig
from ...errors import ConfigError
from ...events import Show, Warn
from ...io.runs import options_of_run
from ...live_options import LiveOptions
from ...presets import on_card, on_cpu
from ...quoting import brief
from ..terminal.run_job import OutputOptions
from .data_options import given_data
from .option_names_3dgs import translated
from .run_options import passed_options
from .unused_options import unused_options


@dataclass(frozen=True, kw_only=True)
class TrainRequest:
    """Request of a training: options, capture, output folder and output format."""

    source: Path | None
    """Capture; None: that of the run or config file."""
    output: Path
    """Folder for the results."""
    preset: str | None = None
    config: Path | None = None
    """config.json of another run."""
    resume: bool = False
    overwrite: bool = False
    start_checkpoint: Path | None = None
    block: int | None = None
    """Block of a split capture; None: all."""
    finds_cameras: bool = True
    """Whether the cameras of photos without cameras are found first."""
    data: Mapping[str, Any]
    """Given options of `DataConfig`."""
    train: Mapping[str, Any]
    """Given options of `TrainConfig`, those with 3DGS names included."""
    live: LiveOptions
    """Viewer server; port 0: off."""
    shown: OutputOptions
    given: Mapping[str, Any]
    """All given arguments as typed, for messages about them and for comparing ranks."""

    @classmethod
    def of(cls, args: argparse.Namespace) -> "TrainRequest":
        """Read the arguments.

        Raises:
            ConfigError: arguments that contradict, or an invalid port.
        """
        source = args.source or args.source_option
        if args.source and args.source_option and args.source != args.source_option:
            raise ConfigError(
                f"Two captures were given: {brief(args.source)} and {brief(args.source_option)}."
            )
        if args.config and args.preset:
            raise ConfigError(
                "Give either `--preset` or `--config`: a config file contains all options."
            )
        live = LiveOptions(**passed_options(LiveOptions, args))
        train = translated(args) | passed_options(TrainConfig, args)
        # An explicit number lifts its limit by the photos.
        train = {LIFTED_BY[name]: 0 for name in LIFTED_BY.keys() & train.keys()} | train
        return cls(
            source=source,
            output=args.output,
            preset=args.preset,
            config=args.config,
            resume=args.resume,
            overwrite=args.overwrite,
            start_checkpoint=args.start_checkpoint,
            block=args.block,
            finds_cameras=not args.no_sfm,
            data=given_data(args),
            train=train,
            live=replace(live, port=0) if args.disable_viewer else live,
            shown=OutputOptions.of(args),
            given={name: value for name, value in vars(args).items() if value is not None},
        )

    def without(self, name: str) -> "TrainRequest":
        """The request as if the option `name` of the capture had not been given."""
        fewer = [{k: v for k, v in one.items() if k != name} for one in (self.data, self.given)]
        return replace(self, data=fewer[0], given=fewer[1])

    def configs(
        self, *, warn: Callable[[str], None] = lambda text: None, card: bool = False
    ) -> tuple[DataConfig, TrainConfig]:
        """The options of a preset, a config file or the resumed run, overridden by the given ones.

        `warn` is called with sentences on removed options in the config file; `card`: the preset is
        that of a graphics card.

        Raises:
            ConfigError: no capture, no run to resume, or options that contradict.
            FormatError: the config file is invalid.
        """
        source, stored = self.source, self.config
        recipe = on_card if card else on_cpu
        if self.resume and not (self.config or (self.preset and source)):
            stored = self.output / "config.json"
            if not stored.is_file():
                from ...trainer.files.run_folder import check_free

                check_free(self.output)  # a run that has just begun has written nothing yet
                raise ConfigError(f"{self.output} contains no run to resume; leave out `--resume`.")
        if self.preset and stored:
            data, config = recipe(self.preset, options_of_run(stored)[0].source)
        elif stored:
            # The checkpoint of a resumed run has the same options, and warns of them.
            found = options_of_run(stored) if self.resume else options_of_run(stored, warn=warn)
            data, config = found
            data = replace(data, source=source or data.source)
        elif source is None:
            raise ConfigError("missing: source. Give the capture: a folder of photos, or a video.")
        else:
            data, config = recipe(self.preset or "normal", source)
        data, config = replace(data, **self.data), replace(config, **self.train)
        if "iterations" in self.train and config.time_budget > 0:
            raise ConfigError(
                f"A time budget ({config.time_budget:g} s) determines the number of steps; leave "
                "out `--iterations`, or give `--time-budget 0`."
            )
        return data, config

    def configs_with_messages(self, show: Show) -> tuple[DataConfig, TrainConfig]:
        """Like `configs`, with a warning about options without effect in this run."""

        def warn(text: str) -> None:
            show(Warn(message=text, code="no_effect"))

        data, config = self.configs(warn=warn)
        if idle := unused_options(self.given, data, config):
            warn(idle)
        return data, config
