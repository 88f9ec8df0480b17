"""`gscore merge`: one splat file from the runs on the blocks of a split capture."""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from ..config import DataConfig, TrainConfig
from ..config_file import differences, load_config
from ..errors import ConfigError, DatasetError
from ..events import ENDED, FINISHED
from ..formats import format_to_write, write_splat_file
from ..formats.joined import joined
from ..io.block_record import BLOCK_RECORD, RUN_BLOCK, BlockRecord, read_block
from ..io.metrics_file import read_metrics
from ..io.ply.comments import near_comment, stated_near
from ..io.runs import is_run, read_run
from ..quoting import as_typed, brief
from ..splats import Splats
from ..text_format import count_text, number
from .args.model_argument import ModelArgument, open_model
from .parser import add_option, add_result_options
from .terminal.output import check_folder, check_replaced, print_result
from .terminal.status import Status, print_warnings


@dataclass(frozen=True, kw_only=True)
class TrainedBlock:
    """Training result of a block."""

    path: Path
    """Path of the run, for messages."""
    record: BlockRecord
    splats: Splats
    """Splats in COLMAP's world."""
    origin: np.ndarray | None = None
    """[3] float64, local origin of the splats, the same for all blocks."""


@dataclass(frozen=True, kw_only=True)
class Merged:
    """Merged blocks."""

    splats: Splats
    kept: tuple[int, ...]
    """Number of kept splats per block."""


def check_complete(runs: Sequence[tuple[Path, BlockRecord]]) -> None:
    """Raise unless these are all blocks of one split, each once.

    Raises:
        ConfigError: blocks are of different splits, duplicate or missing.
    """
    first_path, first = runs[0]
    found: dict[int, Path] = {}
    for path, record in runs:
        if record.split != first.split or not replace(record, index=first.index).is_cell_of(first):
            raise ConfigError(
                f"{path} and {first_path} were trained on blocks that were not cut together. "
                "Train all blocks of one `gscore split`."
            )
        if record.index in found:
            raise ConfigError(
                f"{path} and {found[record.index]} were trained on the same block, "
                f"{record.index}; give one of them."
            )
        found[record.index] = path
    missing = [index for index in range(first.count) if index not in found]
    if missing:
        listed = ", ".join(map(str, missing[:10])) + (", ..." if len(missing) > 10 else "")
        raise ConfigError(
            f"{number(len(missing))} of {count_text(first.count, 'block')} "
            f"{'is' if len(missing) == 1 else 'are'} missing: {listed}. Train them "
            f"(gscore train BLOCKS --block {missing[0]} -o RUNS), or give their runs too."
        )


def merge_blocks(blocks: Sequence[TrainedBlock]) -> Merged:
    """Keep the splats of each block whose centres are in its cell, in the order of the blocks.

    Cells fill the world without overlap, so nothing is duplicated or lost at a seam. Splats outside
    the view of a block's photos also belong to the cell they are in.

    Args:
        blocks: All blocks of one split, checked by `check_complete`.
    """
    parts = []
    for block in sorted(blocks, key=lambda block: block.record.index):
        inside = block.record.contains(block.splats.means.astype(np.float64), block.origin)
        parts.append(block.splats.subset(inside))
    return Merged(splats=joined(parts), kept=tuple(len(part) for part in parts))


_FREE = ("seed", "threads", "cache_mb", "checkpoint_seconds", "preview_seconds", "snapshot_every")
"""Options that may differ between blocks without a warning."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    option = partial(add_option, parser)
    option("runs RUN...", "folders of the runs, or one folder that contains them", Path)
    option("-o, --output OUTPUT", "splat file to write, such as merged.ply", Path, required=True)
    option(
        "--blocks BLOCKS",
        "folder of the blocks, for runs that do not record it; default: as recorded by the runs",
        Path,
    )
    add_result_options(parser, replaced="a file")


def run(args: argparse.Namespace) -> int:
    """Check all runs, merge the splats of each block's own cell, write, print counts."""
    _check_outside_runs(args.output)
    parts = format_to_write(args.output).part_files(args.output)
    check_replaced([args.output, *parts], overwrite=args.overwrite)
    check_folder(args.output.parent)
    runs = _runs(args.runs)
    records = [_record(path, args.blocks) for path in runs]
    check_complete(list(zip(runs, records, strict=True)))
    warnings = [sentence for path in runs for sentence in (*_stopped(path), *_unsure(path))]
    with Status(sys.stderr, quiet=args.quiet) as status:
        models = []
        for i, path in enumerate(runs):
            status.show([f"Reading run {i + 1} of {len(runs)}"])
            models.append(open_model(path))
        models = [model.about(models[0].origin) for model in models]
        warnings += _compare(runs, models)
        merged = merge_blocks(
            [
                TrainedBlock(path=path, record=record, splats=model.splats, origin=model.origin)
                for path, record, model in zip(runs, records, models, strict=True)
            ]
        )
        status.show(["Writing the splats"])
        stated = [near for m in models if (near := stated_near(m.file.comments)) is not None]
        near = [near_comment(min(stated))] if stated else []
        written = write_splat_file(
            args.output,
            merged.splats,
            antialiased=models[0].antialias,
            origin=models[0].origin,
            comments=("Merged by gscore", *near),
        )
    warnings += written.notes
    order = sorted(range(len(runs)), key=lambda i: records[i].index)
    trained = [len(models[i].splats) for i in order]
    blocks = [
        {"run": str(runs[i]), "splats": count, "kept": kept}
        for i, count, kept in zip(order, trained, merged.kept, strict=True)
    ]
    facts = {"output": str(args.output), "splats": len(merged.splats), "blocks": blocks}
    if not args.json:
        print_warnings(warnings)
    lines = [
        f"  block {records[i].index}: {number(kept)} of {count_text(count, 'splat')}"
        for i, count, kept in zip(order, trained, merged.kept, strict=True)
    ]
    head = f"{brief(args.output)}: {count_text(len(merged.splats), 'splat')} of"
    print_result(facts | {"warnings": warnings}, [head, *lines], json=args.json, quiet=args.quiet)
    return 0


def _runs(given: list[Path]) -> list[Path]:
    """The runs; a folder that is not a run is replaced by the runs inside it."""
    found: list[Path] = []
    for path in given:
        if (path / "config.json").is_file():
            found.append(path)
            continue
        if not path.is_dir():
            raise ConfigError(f"{brief(path)} is not a folder; give the folders of the runs.")
        inside = sorted(folder.parent for folder in path.glob("*/config.json"))
        if not inside:
            raise DatasetError(
                f"{brief(path)} is not a run and contains none; give the output of gscore train."
            )
        found += inside
    return found


def _record(run: Path, blocks: Path | None) -> BlockRecord:
    """The block of a run: the one recorded in the run, else the one in its training folder.

    Raises:
        ConfigError: that folder contains a block of another split.
    """
    source = load_config(run / "config.json")[0].source
    folder = source if blocks is None else blocks / source.name
    current, recorded = read_block(folder), read_block(run, RUN_BLOCK)
    if current is not None and recorded is not None and not current.is_cell_of(recorded):
        raise ConfigError(
            f"{brief(run)} was trained on block {recorded.index} of {recorded.count} of "
            f"another split than the one in {brief(folder)} now. Train the new blocks, or move "
            "them away to merge the runs by their recorded cells."
        )
    if (known := recorded or current) is not None:
        return known
    if not folder.is_dir():
        raise DatasetError(
            f"{brief(run)} was trained on {brief(folder)}, which no longer exists. Give the folder "
            "of the blocks with `--blocks`."
        )
    raise ConfigError(
        f"{brief(run)} was trained on {brief(folder)}, which is not a block: it has no "
        f"{BLOCK_RECORD}. Only runs on blocks of `gscore split` can be merged."
    )


def _unsure(path: Path) -> Iterator[str]:
    """A sentence if a run does not record its block."""
    if not (path / RUN_BLOCK).is_file():
        yield (
            f"{brief(path)} does not record its block (no {RUN_BLOCK}), so the current one in its "
            "training folder is used. If that was split again since, train again."
        )


def _check_outside_runs(output: Path) -> None:
    """Raise ConfigError if the output is in the folder of a run."""
    inside = next(filter(is_run, output.resolve().parents), None)
    if inside is not None:
        raise ConfigError(
            f"{brief(output)} is in the folder of a training, {brief(inside)}, whose results it "
            "could replace. Choose an output outside."
        )


def _stopped(path: Path) -> Iterator[str]:
    """A sentence if a run was stopped before its last step.

    Raises:
        ConfigError: it was killed and has no splats.
    """
    run = read_run(path)
    if run is not None and run.splats is None:
        raise ConfigError(
            f"{brief(path)} has not ended: it has a checkpoint after "
            f"{count_text(run.steps, 'step')}, but no splats. Continue with: "
            f"{as_typed('train', '-o', path, '--resume')}"
        )
    reason = str(read_metrics(path).get("reason") or FINISHED)
    if run is not None and reason not in ENDED:
        yield (
            f"{brief(path)} was stopped after {count_text(run.steps, 'step')} ({reason}). To "
            f"complete it: {as_typed('train', '-o', path, '--resume')}; then merge again."
        )


def _compare(runs: list[Path], models: list[ModelArgument]) -> list[str]:
    """Sentences on options in which runs differ.

    Raises:
        ConfigError: splats of these runs cannot be rendered together.
    """
    warnings = [sentence for model in models for sentence in model.warnings]
    first = models[0]
    for path, model in zip(runs[1:], models[1:], strict=True):
        if model.antialias != first.antialias:
            raise ConfigError(
                f"{brief(runs[0])} and {brief(path)} differ in `--antialias`, so their splats "
                "cannot be rendered together. Train one of them again."
            )
        changed = [*_changed(first.train, model.train), *_changed(first.data, model.data)]
        if changed:
            warnings.append(
                f"{brief(path)} was trained with other options than {brief(runs[0])}: "
                f"{'; '.join(changed[:3])}{'; ...' if len(changed) > 3 else ''}."
            )
    return warnings


def _changed(first: object, other: object) -> list[str]:
    if not isinstance(first, TrainConfig | DataConfig):
        return []
    return differences(first, other, ignore=(*_FREE, "source", "iterations"))
