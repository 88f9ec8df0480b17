"""Conversion of formats whose packages Blender's Python lacks, by the trainer's Python."""

import json
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np

from .. import preferences
from ..core import (
    BackendError,
    GsError,
    SplatFile,
    Splats,
    SurfaceMesh,
    atomic_write,
    read_splat_file,
    write_splat_file,
    write_surface,
)
from ..process.child_program import Process
from ..process.incremental_tasks import Check
from ..trainer_python import setup


@dataclass(frozen=True, kw_only=True)
class OtherPython:
    """Another Python, and its temporary folder."""

    python: Path | None
    """Python executable; None: not set up."""
    folder: str
    """Folder of temporary files."""


def other_python() -> OtherPython:
    """The trainer's Python; call on Blender's main thread."""
    try:
        python = setup.trainer_python(preferences.get())
    except ValueError:
        python = None
    return OtherPython(python=python, folder=bpy.app.tempdir)


def read(path: Path, by: OtherPython, check: Check) -> SplatFile:
    """Like `read_splat_file`, by another Python if this one lacks a package; in any thread.

    Args:
        path: The file.
        by: As `other`.
        check: Raises after cancellation; the other Python is then killed.

    Raises:
        GsError: it cannot be read by either.
    """
    try:
        return read_splat_file(path)
    except BackendError as error:
        missing = error
    with tempfile.TemporaryDirectory(prefix="gscore-", dir=by.folder) as folder:
        made = Path(folder, f"{path.stem}.ply")
        warnings = _convert(path, made, by.python, check, missing)
        file = read_splat_file(made)
    return replace(file, path=path, notes=(*file.notes, *warnings))


def write(
    path: Path,
    splats: Splats,
    by: OtherPython,
    check: Check,
    *,
    antialiased: bool,
    origin: np.ndarray | None,
    proxy: SurfaceMesh | None,
    missing: BackendError,
) -> Sequence[str]:
    """Write a file by another Python, completely or not at all; in any thread.

    Args:
        path: The file.
        splats: The splats to write.
        by: As `other`.
        check: As in `read`; `path` is then unchanged.
        antialiased: As in `write_splat_file`.
        origin: As in `write_splat_file`.
        proxy: Mesh to write hidden into the file, with the same local origin; None: none.
        missing: Error of this Python.

    Returns:
        Sentences on data that the format cannot store.

    Raises:
        GsError: it cannot be written.
    """
    with tempfile.TemporaryDirectory(prefix="gscore-", dir=by.folder) as folder:
        whole = Path(folder, "splats.ply")
        write_splat_file(whole, splats, antialiased=antialiased, origin=origin)
        more: list[str | Path] = []
        if proxy is not None:
            more = ["--proxy", Path(folder, "proxy.ply")]
            write_surface(more[1], proxy)
        made = Path(folder, "made", path.name)
        made.parent.mkdir()
        notes = _convert(whole, made, by.python, check, missing, more)
        # Referenced files first.
        for part in sorted(made.parent.iterdir(), key=lambda one: one.name == path.name):
            with part.open("rb") as source:
                copy = lambda file, source=source: shutil.copyfileobj(source, file, 1 << 22)  # noqa: E731
                atomic_write(path.with_name(part.name), copy)
    return notes


def _convert(
    source: Path,
    target: Path,
    python: Path | None,
    check: Check,
    missing: BackendError,
    more: Sequence[str | Path] = (),
) -> list[str]:
    """Convert a file by another Python, with more arguments; returns the warnings of `gscore
    convert`."""
    if python is None:
        raise GsError(
            f"{missing} Or set up a Python for training that has it: press Find or Make "
            "Environment in the add-on's preferences."
        ) from missing
    command = [python, "-m", "gscore", "convert", source, target, *more, "--json"]
    try:
        process = Process([str(word) for word in command])
    except OSError as error:
        raise GsError(
            f"{python} cannot be run ({error.strerror or error}); press Check in the add-on's "
            "preferences."
        ) from error
    output = process.output(check)
    if process.returncode:
        text = " ".join(process.stderr_tail)
        raise GsError(
            f"{source.name} could not be converted to {target.name} by {python}: "
            f"{text.rpartition('error: ')[2] or f'exit code {process.returncode}'}"
        ) from missing
    return json.loads("\n".join(output))["warnings"]
