"""Shared parts of several benches: options of trainings, changes, cells, results, progress."""

import argparse
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from ..._version import __version__
from ...bench.time_error import Curve, Size
from ...bench.training import Variant
from ...config import LIFTED_BY, DataConfig, Skip, Strategy, TrainConfig
from ...config_file import from_dict, to_dict
from ...errors import BackendError, ConfigError
from ...events import strict_json
from ...io.files import atomic_write
from ...io.output_paths import check_output_path
from ...json_text import parse_json
from ...metrics.machine import machine
from ...option_marks import mark_option
from ...presets import RECIPES
from ...quoting import brief, quoted
from ...raster import native_library
from ...raster.gpu.choice import Chosen
from ...text_format import number
from ...trainer.files.checkpoint import FREE
from ..args.data_options import add_data_options, with_data_options
from ..args.device_option import add_device_option
from ..parser import add_option, add_threads_option
from ..terminal.output import MARKDOWN_MARK, check_folder, print_json
from ..terminal.status import Status, show_while, wrapped

_EVERY = 8
"""Every eighth view is held out by default."""


def add_training_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options that change a preset, and those of the capture."""
    option = partial(add_option, parser)
    option("--iterations ITERATIONS", "number of training steps; default: the preset's", int)
    option("--max-splats MAX_SPLATS", "cap of the number of splats; default: the preset's", int)
    option("--strategy", "densification strategy", choices=tuple(Strategy))
    add_threads_option(parser)
    add_device_option(parser, default="cpu")
    add_data_options(parser)


def named_sources(sources: Sequence[Path]) -> dict[str, Path]:
    """Captures by the names of their folders.

    Raises:
        ConfigError: two have one name.
    """
    named: dict[str, Path] = {}
    for source in sources:
        name = source.resolve().name
        if name in named:
            raise ConfigError(f"Two captures are called {quoted(name)}; give them different names.")
        named[name] = source
    return named


def training_configs(
    args: argparse.Namespace, source: Path, preset: str
) -> tuple[DataConfig, TrainConfig]:
    """Preset `preset` for `source` with the given options; some views are always held out."""
    data, train = RECIPES[preset](source)
    data = with_data_options(data, args)
    if not data.eval:
        data = replace(data, eval=True, test_every=_EVERY)
    given = {
        name: getattr(args, name)
        for name in ("iterations", "max_splats")
        if getattr(args, name) is not None
    }
    given |= {LIFTED_BY[name]: 0 for name in given}  # as for `gscore train`
    if args.strategy is not None:
        given["strategy"] = Strategy(args.strategy)
    return data, replace(train, threads=args.threads, device=args.device, **given)


class Ticker:
    """Progress of a training on a status line."""

    def __init__(self, capture: str, status: Status) -> None:
        self._capture, self._status = capture, status

    def __call__(self, label: str, seed: int, step: int, iterations: int) -> None:
        """Show that a step of the training with this label and seed is done."""
        which = f"{self._capture}, {label}, seed {seed}"
        far = f"step {number(step)} of {number(iterations)}"
        self._status.show([which, far], share=step / iterations)
        if step == iterations:
            self._status.clear()


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One split of one capture, and the trainings on it."""

    capture: str
    """Its name, with the thinning if any."""
    offset: int = 0
    variants: list[Variant]
    """All are measured on the same photos; the first is the baseline."""
    sizes: list[tuple[Size, Variant]] = field(default_factory=list)
    """Model sizes, measured on the largest photos among them."""
    peers: list[Curve] = field(default_factory=list)
    """Curves of other programs."""


class ResultsFile:
    """results.json in the output folder, written after each training."""

    def __init__(self, output: Path, device: Chosen, **content: Any) -> None:
        """Start the content, with the version, the machine and the device that trains."""
        self.path = output / "results.json"
        self.content: dict[str, Any] = {
            "gscore": __version__,
            "finished": False,
            "machine": machine(),
            "device": device.name,
            "isa": device.identity,
            **content,
        }

    def write(self, page: str = "", **content: Any) -> None:
        """Update the content and write the file, and results.md with `page` if there is one."""
        self.content |= content
        atomic_write(self.path, (self.text() + "\n").encode())
        if page:
            atomic_write(self.path.with_suffix(".md"), f"{MARKDOWN_MARK}{page}\n".encode())

    def text(self) -> str:
        """The content of the file."""
        return strict_json(self.content)


def check_bench(args: argparse.Namespace) -> None:
    """Remove repeated seeds, and check the output folder.

    Raises:
        ConfigError: it cannot be written, or is that of a capture.
    """
    args.seeds = list(dict.fromkeys(args.seeds))
    check_folder(args.output)
    for source in args.sources:
        check_output_path(args.output, DataConfig(source=source))


def train_cells(cells: deque[Cell], train: Callable[[Cell, Status], None]) -> None:
    """Call `train` with each cell, with a status line, and free its photos afterwards."""
    with Status(sys.stderr) as status:
        while cells:
            train(cells.popleft(), status)


_MOST = 10**8
"""Ten times the splats of a large scene; they need 24 GB."""


def check_numbers(args: argparse.Namespace, least: int, *names: str) -> None:
    """Raise ConfigError if a number of an option is less than `least` or absurdly large."""
    for name in names:
        value = getattr(args, name)
        for given in value if isinstance(value, Sequence) else [value]:
            if given < least:
                raise ConfigError(
                    f"{mark_option(name)} must be at least {least}, got {quoted(given)}."
                )
            if given > _MOST:
                raise ConfigError(
                    f"{mark_option(name)} must be at most {number(_MOST)}, got {brief(given)}."
                )


_NOT_HERE = ("seed", "start_opacity", *sorted(FREE - {"iterations", *LIFTED_BY.values()}))
"""Options that benches set themselves, or that do not affect a training from points."""


def changed(config: TrainConfig, changes: Sequence[str], *, flag: str) -> TrainConfig:
    """`config` with all these changes.

    Args:
        config: Options to change.
        changes: Each a strategy, a skip to disable, or OPTION=VALUE.
        flag: The command-line option with the changes, for messages.

    Raises:
        ConfigError: there is no such change, or the value is invalid.
    """
    for name in changes:
        config = _changed(config, name, flag)
    return config


def _changed(config: TrainConfig, name: str, flag: str) -> TrainConfig:
    if name in tuple(Strategy):
        return replace(config, strategy=Strategy(name))
    if name in tuple(Skip):
        return replace(config, without=(*config.without, Skip(name)))
    option, equals, value = name.partition("=")
    option = option.replace("-", "_")
    if not equals or option in _NOT_HERE or option.startswith("depth_"):
        known = ", ".join((*Strategy, *Skip))
        raise ConfigError(
            f"There is no change {quoted(name)} for {flag}; there are: {known}, and OPTION=VALUE "
            "for options of gscore.TrainConfig that affect a training without depth maps."
        )
    values = to_dict(config) | {option: _value(value, getattr(config, option, None))}
    if option in LIFTED_BY:  # as for `gscore train`
        values[LIFTED_BY[option]] = 0
    return from_dict(TrainConfig, values, where=f"{flag} {name}")


def _value(text: str, now: Any) -> Any:
    """The value of `text` for an option with the value `now`."""
    if isinstance(now, bool) and text in ("on", "off"):
        return text == "on"
    try:
        return parse_json(text)
    except ValueError:
        return text


def for_each_isa(
    args: argparse.Namespace, what: str, measure: Callable[[], Any], table: Callable[[Any], str]
) -> None:
    """Measure with the instruction set `args.isa`, or with each if it is `all`; print the tables,
    or JSON: one object, or a list of several.

    Args:
        args: Arguments with `isa` and `json`.
        what: Size of the work, for the status line.
        measure: Measures once.
        table: The text of a measurement.
    """
    available = native_library.available_isas()
    results = []
    for isa in available if args.isa == "all" else [args.isa or native_library.isa()]:
        native_library.set_isa(isa)
        results.append(_measured(args, f"{isa}, {what}", measure, table))
    _print_json(args, results)


def measured(
    args: argparse.Namespace, what: str, measure: Callable[[], Any], table: Callable[[Any], str]
) -> None:
    """Measure once; as `for_each_isa` otherwise."""
    _print_json(args, [_measured(args, what, measure, table)])


def _measured(
    args: argparse.Namespace, what: str, measure: Callable[[], Any], table: Callable[[Any], str]
) -> Any:
    with show_while(sys.stderr, f"Measuring {what}"):
        result = measure()
    if not args.json:
        sys.stdout.write(wrapped(table(result), sys.stdout))
    return result


def _print_json(args: argparse.Namespace, results: Sequence[Any]) -> None:
    if args.json:
        found = [{"machine": machine()} | asdict(result) for result in results]
        print_json(found[0] if len(found) == 1 else found)


_ERROR = ": error: "
"""Prefix of the message of a failed verb."""


def run_child(arguments: Sequence[str], *, what: str) -> str:
    """Run Python with these arguments.

    Args:
        arguments: Arguments after `python`.
        what: Verb phrase for messages, such as "measures a step".

    Returns:
        The text on stdout.

    Raises:
        BackendError: it failed; the message ends with that of the process.
    """
    command = [sys.executable, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode < 0:
        raise BackendError(
            f"The process that {what} was ended by signal {-done.returncode}, probably because "
            "memory ran out: try fewer splats or smaller pictures."
        )
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        own = next((line.partition(_ERROR)[2] for line in lines if _ERROR in line), None)
        # Without a message of a verb it is an error inside gscore: report all lines.
        message = own or "\n".join(lines)
        raise BackendError(f"The process that {what} failed: {message}")
    return done.stdout
