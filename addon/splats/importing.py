"""Import of splat files: read in a thread, written to Blender in short steps.

The scene, the collection and the parents are looked up at the end, because undo or the user may
have removed them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import bpy
import numpy as np

from .. import attributes, stored_paths
from ..core import GsError, RunInfo, collected_warnings, read_run
from ..interface.blocks import block_of, with_uid
from ..process.incremental_tasks import Check, Steps, run_in_thread
from . import objects, settings, splat_files
from .splat_files import ImportRequest
from .write_chunked import ChunkedWrite, filled

Columns = Sequence[tuple[str, str, np.ndarray]]
"""Attributes as `attributes.columns` returns them."""


@dataclass(frozen=True, kw_only=True)
class _Read:
    """Contents of a read file."""

    request: ImportRequest
    count: int
    columns: tuple[tuple[str, str, np.ndarray], ...]
    size: float
    """Typical size of a splat, from `attributes.typical_size`."""
    antialiased: bool
    origin: np.ndarray | None
    comments: tuple[str, ...]
    run: RunInfo | None
    """The finished run whose result the file is; None: it is of none."""
    note: str
    warnings: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class ImportedSplats:
    """Result of an import."""

    objects: list[bpy.types.Object]
    """One per file."""
    notes: list[str]
    """Results of `note`, one per file."""
    warnings: list[str]
    """Warnings for the user."""


def importing_splats(
    context: bpy.types.Context,
    requests: Sequence[ImportRequest],
    *,
    find: Callable[[ImportRequest], ImportRequest] = lambda request: request,
    note: Callable[[Columns], str] = lambda columns: "",
) -> Steps[ImportedSplats]:
    """Import some files: all of them, or none.

    Args:
        context: Its scene and collection, as at the first step, receive the objects.
        requests: At least one file.
        find: Resolves the file, if it must be searched for; runs in the thread.
        note: Summarises the attributes of each file, for `notes`; runs in the thread.

    Raises:
        GsError, ValueError: a file cannot be imported, or the scene was removed; nothing is left.
    """
    scene_uid = context.scene.session_uid
    collection_uid = getattr(context.collection, "session_uid", 0)
    reads = []
    for request in requests:
        read = partial(_read, request, find, note)
        reads.append((yield from run_in_thread(read, f"Reading {request.path.name}")))
    yield from settings.building()
    gone = "The scene of this import was removed; import the splats again."
    found = partial(block_of, bpy.data.scenes, scene_uid, gone)
    meshes = yield from filled([ChunkedWrite(one) for one in reads], found)
    scene = found()
    within = [scene.collection, *scene.collection.children_recursive]
    collection = with_uid(within, collection_uid) or within[0]
    made, warnings = [], [text for read in reads for text in read.warnings]
    for read, mesh in zip(reads, meshes, strict=True):
        mesh.name = read.request.path.stem
        ob = objects.around(mesh, read.size, collection=collection)
        splat_files.set_up_object(ob, read.request, read)
        _note_run(ob, read.run)
        if read.request.parent and ob.parent is None:
            warnings.append(
                f"The parent of {ob.name} was removed during the import; it has no parent."
            )
        made.append(ob)
    return ImportedSplats(objects=made, notes=[read.note for read in reads], warnings=warnings)


def _run_of(path: Path) -> RunInfo | None:
    """The run whose result a file is; None: it is of none, or its options cannot be read."""
    run = read_run(path.parent)
    return run if run is not None and run.data is not None and run.splats == path else None


def _note_run(ob: bpy.types.Object, run: RunInfo | None) -> None:
    """Link imported splats to their run and capture, as a training from the panel does."""
    if run is not None:
        stored_paths.write(ob, stored_paths.RUN, run.path)
        stored_paths.write(ob, stored_paths.SOURCE, run.data.source)


def _read(
    request: ImportRequest,
    find: Callable[[ImportRequest], ImportRequest],
    note: Callable[[Columns], str],
    check: Check,
) -> _Read:
    """Read a file; runs in the thread."""
    with collected_warnings() as warnings:
        request = find(request)
        try:
            file = splat_files.read(request, check)
            check()
            columns = tuple(attributes.columns(file.splats))
        except MemoryError as error:
            raise GsError(
                f"{request.path} does not fit into memory; close other programs and import it "
                "again."
            ) from error
        check()
        return _Read(
            request=request,
            count=len(file.splats),
            columns=columns,
            size=attributes.typical_size(file.splats),
            antialiased=file.antialiased,
            origin=file.origin,
            comments=tuple(file.comments),
            run=_run_of(request.path.absolute()),
            note=note(columns),
            warnings=tuple(warnings),
        )
