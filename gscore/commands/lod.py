"""`gscore lod`: levels of detail of a model larger than memory, built once."""

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import Any

from ..config_file import load_config
from ..errors import ConfigError
from ..formats import files_of, is_antialiased
from ..io.cameras_json import read_cameras_json
from ..io.files import is_file
from ..io.lod_file import LOD_ENDING, is_lod_file
from ..io.lod_index import LodIndex
from ..io.ply.splats import header_comments
from ..lod.build import LodFacts, build_lod
from ..lod.measure import measured_levels
from ..quoting import brief
from ..text_format import count_text, number, size_text
from ..warning_log import collected_warnings
from .args.device_option import add_device_option, device_of
from .args.model_argument import (
    background_of,
    find_run,
    find_splats,
    trained_antialiased,
    trained_near,
)
from .parser import add_option, add_result_options
from .terminal.output import check_folder, check_replaced, print_result
from .terminal.status import Status, print_warnings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    option = partial(add_option, parser)
    option("model", "folder of a run, or a splat file", Path)
    option("-o, --output OUT.lod", "output file, for gscore render", Path, required=True)
    add_device_option(parser)
    add_result_options(parser, replaced="a file")


def run(args: argparse.Namespace) -> int:
    """Build and measure the levels, and print a summary of each."""
    if args.output.suffix.lower() != LOD_ENDING:
        raise ConfigError(
            f"{brief(args.output)}: the output is a {LOD_ENDING} file; give a name that ends in "
            f"{LOD_ENDING} with -o."
        )
    check_folder(args.output.parent)
    check_replaced([args.output], overwrite=args.overwrite)
    model = find_splats(args.model)
    if is_lod_file(model):
        raise ConfigError(
            f"{brief(model)} contains levels of detail already. Give the original splat file, or "
            f"write it with gscore convert."
        )
    _check_not_the_model(args.output, model)
    facts = _facts_of(model)
    device = device_of(args)
    with Status(sys.stderr, quiet=args.quiet) as status, collected_warnings() as warnings:
        index = build_lod(
            model,
            args.output,
            facts,
            on_share=lambda what, share: status.show([what], share=share),
            measured=partial(measured_levels, device=device),
        )
    result = lod_facts(args.output, index) | {"warnings": list(dict.fromkeys(warnings))}
    if not args.json:
        print_warnings(result["warnings"])
    print_result(result, lod_text(result), json=args.json, quiet=args.quiet)
    return 0


def lod_facts(path: Path, index: LodIndex) -> dict[str, Any]:
    """Content of a file of levels of detail, as JSON values."""
    finest = index.levels[0]
    return {
        "kind": "levels of detail",
        "path": str(path),
        "splats": index.levels[0].splats,
        "sh_degree": index.sh_degree,
        "storage_bytes": path.stat().st_size,
        "antialias": index.antialias,
        "origin": None if index.origin is None else index.origin.tolist(),
        "cameras": 0 if index.cameras is None else len(index.cameras),
        "bounds": [finest.low.min(axis=0).tolist(), finest.high.max(axis=0).tolist()],
        "levels": [
            {
                "splats": level.splats,
                "chunks": len(level.counts),
                "error": level.error,
                "psnr": level.psnr,
                "against": level.against,
            }
            for level in index.levels
        ],
    }


def lod_text(facts: dict[str, Any]) -> list[str]:
    """The same as lines of text."""
    marks = ", trained with antialiasing" if facts["antialias"] else ""
    lines = [
        f"{facts['path']}: {count_text(facts['splats'], 'splat')} with "
        f"{count_text(len(facts['levels']), 'level')} of detail, SH degree {facts['sh_degree']}, "
        f"{size_text(facts['storage_bytes'])}{marks}",
        f"  {'level':>5}{'splats':>13}{'chunks':>9}{'error':>10}  pictures at an error of 1 px",
    ]
    for number_of, level in enumerate(facts["levels"]):
        worth = "exact" if not number_of else "not measured"
        if level["psnr"] is not None:
            worth = f"{level['psnr']:.1f} dB against level {level['against']}"
        lines.append(
            f"  {number_of:5}{number(level['splats']):>13}{number(level['chunks']):>9}"
            f"{level['error']:10.3g}  {worth}"
        )
    return lines


def _facts_of(model: Path) -> LodFacts:
    """Metadata of the file and its run."""
    run = find_run(model)
    train = load_config(run / "config.json")[1] if run else None
    comments = header_comments(model) if is_file(model) else ()
    beside = (run or model.parent) / "cameras.json"
    return LodFacts(
        antialias=is_antialiased(model) or trained_antialiased(train),
        near=trained_near(comments, run, train),
        background=background_of(train),
        cameras=read_cameras_json(beside) if is_file(beside) else None,
    )


def _check_not_the_model(output: Path, model: Path) -> None:
    if any(output.exists() and output.samefile(read) for read in files_of(model)):
        raise ConfigError(f"{brief(output)} is the input file; choose another output to keep it.")
