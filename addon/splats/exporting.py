"""Export of splat objects to one file, in short steps."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from .. import attributes
from ..cameras.capture_transform import origin_of
from ..cameras.objects import local_matrix
from ..compat import matrix_to_numpy
from ..core import (
    BackendError,
    GsError,
    Splats,
    SurfaceMesh,
    TriangleMesh,
    file_errors,
    format_to_write,
    join_splats,
    write_splat_file,
    write_surface,
)
from ..process.incremental_tasks import Check, Steps, run_in_thread
from ..triangles import moved, triangles_of_mesh
from . import conversion, filters, objects
from .filters import Filters
from .read_chunked import ChunkedRead
from .splat_files import BLENDER, SOURCE, note_of_up, source_matrix, source_matrix_of_data

Written = tuple[int, tuple[str, ...]]
"""Number of written splats, and sentences on omitted splats and on data that the format cannot
store."""


_HEAD = 400
"""Bytes of a mesh file in which its writer is named."""


@dataclass(frozen=True, kw_only=True)
class _Part:
    """Export of the splats of one object."""

    name: str
    matrix: np.ndarray
    """[4, 4] from the object's space to the file's."""
    filters: Filters | None
    """Filters; None: all splats are exported."""

    def made(self, columns: dict[str, np.ndarray]) -> Splats:
        """Splats for the file from columns of `ChunkedRead`; ValueError as `objects.moved`."""
        keep = None if self.filters is None else filters.passing(columns, self.filters)
        splats = attributes.as_splats(columns)
        splats = splats if keep is None else splats.subset(keep)
        return objects.moved(splats, self.matrix, self.name)


def exporting(
    obs: Sequence[bpy.types.Object],
    path: str | Path,
    *,
    world: str,
    filtered: bool,
    proxies: bool = False,
) -> Steps[Written]:
    """Write splat objects with their edits and transforms as one file.

    Reads the splats as of the first step, then transforms and writes them in a thread. Cancellation
    leaves the file unchanged.

    Args:
        obs: At least one; several are joined.
        path: The file to write; its extension determines the format.
        world: SOURCE for the world of the first object's photos (or of its file), BLENDER for the
            scene's.
        filtered: Leave out splats that the display filters hide.
        proxies: Also write the objects' proxies as one mesh: hidden in the same file if its format
            has meshes (glTF and USD), else as NAME.proxy.ply.

    Raises:
        ValueError: no objects, no splats, or a matrix that is not a similarity; nothing is written.
        GsError: the file cannot be written.
    """
    if not obs:
        raise ValueError("There is nothing to export: select a splat object.")
    path = Path(bpy.path.abspath(str(path)))
    parts = _parts(obs, world, filtered)
    antialiased = all(ob.get(objects.ANTIALIAS) for ob in obs)
    comments = note_of_up(obs[0], world)
    origin = None if world == BLENDER else origin_of(obs[0])
    mesh = replace(_surface(obs, parts), origin=origin) if proxies else None
    inside = mesh is not None and format_to_write(path).keeps_proxy
    if mesh is not None and not inside:
        _check_replaceable(proxy_path(path))
    taken: list[ChunkedRead] = []
    try:
        for ob in obs:
            taken.append(ChunkedRead(ob))
        read = []
        for one in taken:
            read.append((yield from one.read()))
    finally:
        for one in taken:
            one.drop()

    how = {"antialiased": antialiased, "comments": comments, "origin": origin}
    try:
        splats, total = yield from run_in_thread(partial(_same_file, parts, read), "Collecting")
        notes = yield from _written(path, splats, mesh if inside else None, how)
    except MemoryError as error:
        raise GsError(
            "The splats do not fit into memory twice; close other programs and export again."
        ) from error
    if mesh is not None and not inside:
        write_mesh = partial(_write_surface, proxy_path(path), mesh)
        yield from run_in_thread(write_mesh, "Writing the proxies")
    hidden = total - len(splats)
    left = (f"{hidden:,} splats that the filters hide were left out.",) if hidden else ()
    return len(splats), (*notes, *left)


def _written(
    path: Path, splats: Splats, proxy: SurfaceMesh | None, how: dict[str, Any]
) -> Steps[Sequence[str]]:
    """Write a file, if need be by the trainer's Python; returns its notes.

    Args:
        path: The file.
        splats: All its splats.
        proxy: Mesh for the same file.
        how: Other arguments of `write_splat_file`.
    """
    mesh = None
    if proxy is not None:
        triangles = proxy.triangles.astype(np.int32)
        mesh = TriangleMesh(vertices=proxy.in_capture, triangles=triangles)

    def write(check: Check) -> Sequence[str]:
        with file_errors(check):
            return write_splat_file(path, splats, proxy=mesh, **how).notes

    try:
        return (yield from run_in_thread(write, f"Writing {path.name}"))
    except BackendError as error:
        options = {one: how[one] for one in ("antialiased", "origin")}
        options |= {"proxy": proxy, "missing": error}
        convert = partial(conversion.write, path, splats, conversion.other_python(), **options)
        name = f"Writing {path.name} in the trainer's Python"
        return (yield from run_in_thread(convert, name))


def proxy_path(path: Path) -> Path:
    """The file of the proxies of a splat file."""
    return path.with_name(f"{path.stem}.proxy.ply")


def _surface(obs: Sequence[bpy.types.Object], parts: list[_Part]) -> SurfaceMesh:
    """The proxies of objects as one mesh in the space of the file; ValueError without any."""
    found = []
    for ob, part in zip(obs, parts, strict=True):
        if (proxy := objects.proxy_of(ob)) is None:
            continue
        mesh, matrix = proxy.data, part.matrix @ local_matrix(proxy)
        triangles = triangles_of_mesh(mesh)
        colors = np.ones((len(triangles.vertices), 4), np.float32)
        layer = mesh.color_attributes.active_color
        if layer is not None and layer.domain == "POINT":
            layer.data.foreach_get("color_srgb", colors.ravel())
        found.append(
            SurfaceMesh(
                vertices=moved(triangles.vertices, matrix),
                triangles=triangles.triangles.astype(np.int64),
                colors=np.clip(colors[:, :3], 0, 1),
            )
        )
    if not found:
        raise ValueError("The splats have no proxy to export: make one, or turn Proxies off.")
    return _joined(found)


def _check_replaceable(path: Path) -> None:
    """Raise ValueError if a file of another program has the name of the proxies' file, for which no
    file browser asks."""
    with suppress(FileNotFoundError), path.open("rb") as file:
        if b"gscore" not in file.read(_HEAD):
            raise ValueError(f"{path} is of another program: rename it, or turn Proxies off.")


def _write_surface(path: Path, mesh: SurfaceMesh, check: Check) -> None:
    _check_replaceable(path)
    write_surface(path, mesh)


def _joined(surfaces: list[SurfaceMesh]) -> SurfaceMesh:
    starts = np.cumsum([0, *(len(one.vertices) for one in surfaces)])
    return SurfaceMesh(
        vertices=np.concatenate([one.vertices for one in surfaces]),
        triangles=np.concatenate([s.triangles + n for s, n in zip(surfaces, starts, strict=False)]),
        colors=np.concatenate([one.colors for one in surfaces]),
    )


def _same_file(
    parts: list[_Part], read: list[dict[str, np.ndarray]], check: Check
) -> tuple[Splats, int]:
    """All splats of a file, and their number before filters; `read` is emptied."""
    total, made = 0, []
    for part in parts:
        columns = read.pop(0)
        total += len(columns[attributes.BASE])
        made.append(part.made(columns))
        check()
    splats = join_splats(made)
    if not len(splats):
        names = ", ".join(part.name for part in parts)
        raise ValueError(f"{names}: no splats left to export; relax the filters or undo deletions.")
    return splats, total


def _parts(obs: Sequence[bpy.types.Object], world: str, filtered: bool) -> list[_Part]:
    """One for each object; ValueError if a matrix is not a similarity."""
    to_file = np.eye(4) if world == BLENDER else np.linalg.inv(source_matrix(obs[0]))
    parts = []
    for ob in obs:
        own = source_matrix_of_data(ob) if world == SOURCE and ob == obs[0] else None
        matrix = to_file @ matrix_to_numpy(ob.matrix_world) if own is None else own
        objects.moved(attributes.NO_SPLATS, matrix, ob.name)  # raises unless it is a similarity
        limits = filters.filters_of(ob) if filtered else None
        hides = limits is not None and limits.leave_out_anything
        parts.append(_Part(name=ob.name, matrix=matrix, filters=limits if hides else None))
    return parts
