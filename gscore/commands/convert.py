"""`gscore convert`: splats to another format; optional crop, cleanup, pruning and transform."""

import argparse
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..edit.crop import box_matrix
from ..edit.pipeline import Edited, EditViews, apply_edits
from ..edit.request import USUAL, EditRequest
from ..errors import ConfigError
from ..formats import WrittenFile, files_of, format_to_write, read_splats, write_splat_file
from ..io.files import read_bytes
from ..io.lod_file import is_lod_file
from ..io.mesh.files import read_mesh
from ..io.ply.comments import UP_AXIS, UP_NOTE, near_comment, stated_near, stated_up
from ..lod.read import LOD_FORMAT, read_lod
from ..quoting import brief
from ..scene import splat_near
from ..splats import Splats
from ..text_format import count_text, number, size_text
from ..upright import up_axis
from .args.convert_options import SPZ_VERSION
from .args.convert_options import add_arguments as add_arguments
from .args.model_argument import ModelArgument, find_splats, open_model
from .pictures.before_after import picture_loss, some_view, write_before_after
from .pictures.render_cameras import captured_cameras, view_index
from .terminal.output import check_folder, check_replaced, print_result
from .terminal.status import Status, print_warnings

_EXACT = "ply"
"""The lossless format."""
_VISIBLE = 30.0
"""PSNR between pictures, dB, below which missing splats are clearly visible."""
_VIEWS = 60
"""Default number of views that measure the loss."""
_USUAL_UP = "-Y"
"""Up axis of splats that state none."""
_MARK = "gscore convert"
"""Comment in formats with comments; such files may be replaced."""


def run(args: argparse.Namespace) -> int:
    """Read, edit and write the model, and print a summary."""
    request = _request(args)
    _check_output(args)
    with Status(sys.stderr, quiet=args.quiet) as status:
        facts = _convert(args, request, status)
    print_warnings(facts["warnings"])
    print_result(facts, [_summary(facts)], json=args.json)
    return 0


def _request(args: argparse.Namespace) -> EditRequest:
    """The requested edits, except those that depend on cameras."""
    names = {field.name for field in fields(EditRequest)} - {"frustum", "matrix", "seen_share"}
    given = {name: value for name in names if (value := getattr(args, name)) is not None}
    if args.matrix is not None:
        given["matrix"] = _read_matrix(args.matrix)
    frustum = range(len(args.frustum or ()))  # resolved to cameras once these are read
    if args.clean and args.gap is not None:
        given.setdefault("min_cluster", USUAL.min_cluster)
    return EditRequest(**given, frustum=tuple(frustum))


def _check_output(args: argparse.Namespace) -> None:
    """Raise if a file would be replaced, or written in a form that no reader supports."""
    beside = format_to_write(args.output).part_files(args.output)
    if args.picture is not None and args.picture.suffix.lower() != ".png":
        raise ConfigError(f"{brief(args.picture)}: the picture is a PNG; give a name with .png.")
    if args.picture is None and args.picture_view is not None:
        raise ConfigError("`--picture-view` belongs to `--picture FILE.png`.")
    written = [path for path in (args.output, *beside, args.picture) if path is not None]
    for path in written:
        check_folder(path.parent)
    check_replaced(written, overwrite=args.overwrite)


def _convert(args: argparse.Namespace, request: EditRequest, status: Status) -> dict[str, Any]:
    """Convert; returns the facts for `--json`."""
    status.show(["Reading the splats"])
    models = [_open(path, args) for path in (args.input, *args.merge)]
    models = [model.about(models[0].origin) for model in models]
    _check_not_read(args, models)
    views = _views(args, models[0])
    if args.picture_view is not None:
        _pictured(args, views)
    count = sum(len(model.splats) for model in models)
    request = _with_views(request, args, views, count)
    write = _writer(args, models, request, views)
    edited = apply_edits(
        [model.splats for model in models],
        request,
        views=views,
        bytes_of=lambda splats: _bytes_of(splats, args.output.name, write),
        on_step=lambda step: status.show([step]),
    )
    status.show(["Writing the splats"])
    written = write(args.output, edited.splats)
    after = edited.kept
    if written.format != _EXACT and not request.moves:
        after = read_splats(args.output)  # includes the loss of the format itself
    lost = None
    if views is not None and after is not edited.cropped:
        lost = picture_loss(edited.cropped, after, views, args.views or _VIEWS, status)
        thinned = request.count is not None or request.size is not None
        if thinned and lost.psnr is not None and lost.psnr < _VISIBLE:
            edited.notes.append(
                f"Missing splats are visible in the pictures ({lost.psnr:.1f} dB). If you have the "
                f"photos, a training with `--max-splats {len(edited.splats)}` looks better."
            )
    elif args.views is not None:
        why = "there are no cameras; give them with -s" if views is None else "no splat changed"
        edited.notes.append(f"`--views` has no effect: {why}.")
    if args.picture is not None:
        status.show(["Rendering the picture"])
        _write_picture(args, edited.joined, after, views)
    return _facts(args, models, edited, written) | {"error": None if lost is None else asdict(lost)}


def _open(path: Path, args: argparse.Namespace) -> ModelArgument:
    """Read a model; from a file of levels of detail the requested level, within the box if given.

    Raises:
        ConfigError: a level was requested from a model without levels.
    """
    if is_lod_file(path):
        box = None if args.box is None or args.outside else np.array(args.box).reshape(2, 3)
        if box is not None and (box[0] >= box[1]).any():
            box = None  # the crop reports the error
        to_unit = None if box is None else box_matrix(box[0], box[1])
        found = read_lod(path, args.level or 0, to_unit=to_unit)
        return ModelArgument(file=found, run=None, data=None, train=None)
    find_splats(path)  # reports a missing file before the missing levels
    if args.level is not None:
        raise ConfigError(f"`--level` needs levels of detail, and {brief(path)} has none.")
    return open_model(path)


def _check_not_read(args: argparse.Namespace, models: list[ModelArgument]) -> None:
    made = {args.output, *format_to_write(args.output).part_files(args.output)}
    for model in models:
        read = {model.path} if model.file.format == LOD_FORMAT else files_of(model.path)
        if any(a.exists() and b.exists() and a.samefile(b) for a in made for b in read):
            raise ConfigError(
                f"{brief(args.output)} is an input file; choose another output to keep it."
            )


def _views(args: argparse.Namespace, model: ModelArgument) -> EditViews | None:
    """The cameras of the capture or run; None if there are none and none were given."""
    if args.source is None and not (model.run and (model.run / "cameras.json").is_file()):
        return None
    return EditViews(
        cameras=captured_cameras(args.source, model).cameras,
        antialias=model.antialias,
        near=model.near,
        threads=args.threads,
    )


def _with_views(
    request: EditRequest, args: argparse.Namespace, views: EditViews | None, count: int
) -> EditRequest:
    """The request with the edits that depend on cameras."""
    if request.frustum and views is not None:
        names = views.cameras.names
        frustum = tuple(view_index(view, names) for view in args.frustum)
        request = replace(request, frustum=frustum)
    return request.cleaned(count, with_cameras=views is not None) if args.clean else request


_Write = Callable[[Path, Splats], WrittenFile]


def _writer(
    args: argparse.Namespace,
    models: list[ModelArgument],
    request: EditRequest,
    views: EditViews | None,
) -> _Write:
    """Function that writes splats in the format of a file's name. It keeps the up axis of the first
    model, stated or of its cameras, unless the splats were moved, and its stated near plane."""
    given, comments = models[0].file.comments, [_MARK]
    up = stated_up(given) or ("" if views is None else up_axis(views.cameras))
    if not request.moves and up not in ("", _USUAL_UP):
        is_noted = any(line.startswith(UP_NOTE) for line in given)
        comments.append(f"{UP_NOTE if is_noted else UP_AXIS}{up}")
    proxy = None
    if args.proxy is not None:
        if request.moves:
            raise ConfigError(
                "`--proxy` is not moved with the splats: move them first, make the mesh of the "
                "result, and convert both."
            )
        proxy = read_mesh(args.proxy)
    if (near := stated_near(given)) is not None:
        comments.append(near_comment(near * (request.scale or 1.0)))

    def write(path: Path, splats: Splats) -> WrittenFile:
        return write_splat_file(
            path,
            splats,
            antialiased=models[0].antialias,
            origin=models[0].origin,
            comments=tuple(comments),
            spz_version=args.spz_version,
            proxy=proxy,
        )

    return write


def _bytes_of(splats: Splats, name: str, write: _Write) -> int:
    """File size of these splats, measured by writing a temporary file, since codecs differ."""
    with tempfile.TemporaryDirectory() as folder:
        return write(Path(folder) / name, splats).storage_bytes


def _write_picture(
    args: argparse.Namespace, before: Splats, after: Splats, views: EditViews | None
) -> None:
    index = _pictured(args, views)
    if views is None:
        views = EditViews(
            cameras=some_view(before), near=splat_near(before.means), threads=args.threads
        )
    write_before_after(args.picture, before, after, views, index)


def _pictured(args: argparse.Namespace, views: EditViews | None) -> int:
    """Index of the camera of the picture.

    Raises:
        ConfigError: the named view is unknown.
    """
    if args.picture_view is None:
        return 0 if views is None else len(views.cameras.names) // 2
    if views is None:
        raise ConfigError(
            "There are no cameras to select by name; give their capture or cameras.json with -s."
        )
    return view_index(args.picture_view, views.cameras.names)


def _facts(
    args: argparse.Namespace,
    models: list[ModelArgument],
    edited: Edited,
    written: WrittenFile,
) -> dict[str, Any]:
    warnings = [sentence for model in models for sentence in model.warnings]
    if len({model.antialias for model in models}) > 1:
        warnings.append(
            "Some of the merged splats were trained with antialiasing and some without; all are "
            f"marked like those of {models[0].path}."
        )
    given = [model.path.resolve() for model in models]
    warnings += [
        f"{brief(path)} is given {given.count(path)} times, so its splats are duplicated."
        for path in dict.fromkeys(given)
        if given.count(path) > 1
    ]
    if args.spz_version != SPZ_VERSION and written.format != "spz":
        warnings.append("`--spz-version` has no effect: the output is not an .spz.")
    return {
        "input": [str(model.path) for model in models],
        "output": str(args.output),
        "format": written.format,
        "splats_before": len(edited.joined),
        "splats_read": [len(model.splats) for model in models],
        "whole": all(model.file.format != LOD_FORMAT for model in models),
        "splats": len(edited.splats),
        "sh_degree_before": edited.joined.sh_degree,
        "sh_degree": min(edited.splats.sh_degree, format_to_write(args.output).most_degree),
        "bytes_before": sum(model.file.storage_bytes for model in models),
        "bytes": written.storage_bytes,
        "steps": [asdict(step) for step in edited.steps],
        "picture": None if args.picture is None else str(args.picture),
        "warnings": [*warnings, *edited.notes, *written.notes],
    }


def _summary(facts: dict[str, Any]) -> str:
    lines = [_step_text(step) for step in facts["steps"]]
    if lost := facts["error"]:
        lines.append(_error_text(lost))
    *first, last = facts["splats_read"]
    read = " + ".join([*map(number, first), count_text(last, "splat")])
    lines.append(
        f"Wrote {facts['output']}: {count_text(facts['splats'], 'splat')}, SH degree "
        f"{facts['sh_degree']}, {size_text(facts['bytes'])}; "
        f"{'before' if facts['whole'] else 'read'}: {read}, SH degree {facts['sh_degree_before']}, "
        f"{size_text(facts['bytes_before'])}."
    )
    if facts["picture"]:
        lines.append(f"Before and after: {facts['picture']}")
    return "\n".join(lines)


def _step_text(step: dict[str, Any]) -> str:
    what = "removed" if step["removed"] >= 0 else "added"
    count = f"{number(abs(step['removed'])):>12} {what},"
    return f"  {step['name']:13}{count:21}{number(step['left']):>12} left"


def _error_text(lost: dict[str, Any]) -> str:
    views = count_text(lost["views"], "view")
    if lost["psnr"] is None:
        return f"  pictures of {views} are bit-identical"
    equal = f", {lost['unchanged']} more are bit-identical" if lost["unchanged"] else ""
    changed = lost["views"] - lost["unchanged"]
    return (
        f"  pictures compared to before: {lost['psnr']:.2f} dB in {changed} of {views}{equal}; "
        f"worst {lost['worst_psnr']:.2f} dB, {lost['worst']}"
    )


def _read_matrix(path: Path) -> np.ndarray:
    """[4, 4] float64 from a text of 16 numbers; commas and brackets are ignored."""
    text = read_bytes(path).decode("utf-8", "replace")
    words = text.translate(dict.fromkeys(map(ord, ",;[]()"), " ")).split()
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != 16:
        raise ConfigError(
            f"{brief(path)} contains no matrix: expected 16 numbers, row by row, such as "
            "1 0 0 0  0 1 0 0  0 0 1 0  0 0 0 1."
        )
    return np.array(values).reshape(4, 4)
