"""Splat files: import, and their placement in Blender's world or that of the photos."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import bpy
import numpy as np
from mathutils import Matrix

from ..cameras.capture_transform import ORIGIN, note_origin, noted_origin, origin_of
from ..cameras.objects import local_matrix, root_of
from ..compat import matrix_to_numpy
from ..core import (
    UP_NOTE,
    SplatFile,
    is_lod_file,
    offset_between,
    read_lod,
    stated_up,
)
from ..process.incremental_tasks import Check
from . import conversion
from .filters import crop_matrix, is_cropped
from .objects import ANTIALIAS, keep_children

UP_AXES = {
    "-Y": np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]),
    "Y": np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]),
    "Z": np.eye(4),
    "-Z": np.diag([1.0, -1, -1, 1]),
    "X": np.array([[0.0, 0, -1, 0], [0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]]),
    "-X": np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]),
}
"""Rotation [4, 4] of the named axis of a file to Blender's +Z."""
MOST_AT_ONCE = 1_000_000
"""Largest size of the default level of detail, in splats that Blender can edit fluently."""
SOURCE, BLENDER = "SOURCE", "BLENDER"
FROM_FILE = "FILE"
"""Axis stated by the file; -Y if it states none."""
_USUAL_UP = "-Y"
_BLENDER_NOTE = f"{UP_NOTE}Z"
"""PLY comment of splats in Blender's world."""
_IMPORT_MATRIX = "gs_import_matrix"
_NOISE = 1e-12


@dataclass(frozen=True, kw_only=True)
class ImportRequest:
    """Import request of a file, with the transform of its splats; read without bpy."""

    path: Path
    level: int | None
    to_unit: np.ndarray | None
    """[4, 4] from the file to the unit box of the splats to read; None: all."""
    crop: str
    """Name of the crop object."""
    parent: int
    """Session uid of the future parent; 0: none."""
    basis: tuple[Matrix, Matrix] | None
    """Basis matrix and parent inverse matrix of the cropped object."""
    origin: np.ndarray | None
    """[3] local origin of the parent's capture; None: it has none."""
    stored: tuple[float, ...]
    """Import matrix of the cropped object; empty: none."""
    up: str
    by: conversion.OtherPython
    """Python for formats whose packages Blender's Python lacks."""


def import_request(
    path: str | Path,
    *,
    parent: bpy.types.Object | None = None,
    up: str = FROM_FILE,
    level: int | None = None,
    cropped: bpy.types.Object | None = None,
) -> ImportRequest:
    """Import request of a splat file of any format, or of a part of a file with levels of detail.

    Args:
        path: The file.
        parent: The empty of the capture that the splats were trained from; its alignment applies.
        up: Without `parent`, the axis of the file that points up: `FROM_FILE`, or a key of
            `UP_AXES`. The object is rotated; the data stay in the file's world. A file
            exported in Blender's world keeps its position there, also under a parent.
        level: Level of detail to read, 0 is the finest; None: the finest with at most
            `MOST_AT_ONCE` splats.
        cropped: A splat object of the same file with a crop object. Reads only splats in its box,
            of `level` or the finest, and places them at this object.

    Raises:
        ValueError: `cropped` has no crop object, or the file no levels of detail.
    """
    path = Path(bpy.path.abspath(str(path)))
    if (level is not None or cropped is not None) and not is_lod_file(path):
        raise ValueError(f"{path} has no levels of detail; make them with gscore lod.")
    to_unit, crop, basis, stored = None, "", None, ()
    if cropped is not None:
        if not is_cropped(cropped):
            raise ValueError(f"{cropped.name} has no crop object; add a crop box first.")
        parent, crop = cropped.parent, cropped.gscore.crop_object.name
        to_unit = crop_matrix(cropped, cropped.gscore.crop_object)
        basis = cropped.matrix_basis.copy(), cropped.matrix_parent_inverse.copy()
        stored = tuple(cropped.get(_IMPORT_MATRIX, ()))
    return ImportRequest(
        path=path,
        level=level,
        to_unit=to_unit,
        crop=crop,
        parent=0 if parent is None else parent.session_uid,
        basis=basis,
        origin=origin_of(parent),
        stored=stored,
        up=up,
        by=conversion.other_python(),
    )


def read(request: ImportRequest, check: Check = lambda: None) -> SplatFile:
    """Read an import request, in any thread. `check` raises after cancellation.

    Raises:
        GsError: the file is missing, corrupt or contains no splats.
        ValueError: there is no such level, or no splat in the box.
    """
    if not is_lod_file(request.path):
        file = conversion.read(request.path, request.by, check)
        return file if _BLENDER_NOTE in file.comments else file.of_capture(request.origin)
    if request.to_unit is None:
        return read_lod(request.path, request.level, most=MOST_AT_ONCE)
    file = read_lod(request.path, request.level or 0, to_unit=request.to_unit)
    if not len(file.splats):
        raise ValueError(f"No splat of {request.path} is inside {request.crop}.")
    return file


class FileMetadata(Protocol):
    """Metadata of a splat file."""

    @property
    def antialiased(self) -> bool: ...
    @property
    def origin(self) -> np.ndarray | None: ...
    @property
    def comments(self) -> Sequence[str]: ...


def set_up_object(ob: bpy.types.Object, request: ImportRequest, metadata: FileMetadata) -> None:
    """Place the object of a file as requested; without a parent if that was removed."""
    if metadata.antialiased:
        ob[ANTIALIAS] = True
    uids = {other.session_uid: other for other in bpy.data.objects} if request.parent else {}
    ob.parent = uids.get(request.parent)
    if request.basis is not None:
        ob.matrix_basis, ob.matrix_parent_inverse = request.basis
        if request.stored:
            ob[_IMPORT_MATRIX] = list(request.stored)
        note_origin(ob, metadata.origin)
        return
    is_of_blender = request.up == FROM_FILE and _BLENDER_NOTE in metadata.comments
    if not is_of_blender:
        match_capture_origin(ob, metadata.origin)
    if ob.parent is None:
        stated = stated_up(metadata.comments) if request.up == FROM_FILE else request.up
        place(ob, UP_AXES[stated if stated in UP_AXES else _USUAL_UP])
    elif is_of_blender:
        ob.matrix_parent_inverse = ob.parent.matrix_world.inverted_safe()


def match_capture_origin(ob: bpy.types.Object, origin: np.ndarray | None) -> None:
    """Shift an object whose splats now have a local origin, so that they match its capture, or the
    positions of its earlier splats with another origin."""
    root, before = root_of(ob), origin
    if root is not None:
        before = noted_origin(root)
    if ORIGIN in ob:
        before = noted_origin(ob)
    shift = offset_between(origin, before)
    if shift.any():
        ob.matrix_basis = ob.matrix_basis @ Matrix.Translation(shift)
        keep_children(ob, Matrix.Translation(shift))
    note_origin(ob, origin)


def place(ob: bpy.types.Object, matrix: np.ndarray) -> None:
    """Set the transform of an object without a capture, by a similarity [4, 4] that makes its data
    upright. It is stored, so that an export can undo it.
    """
    ob.matrix_basis = Matrix(matrix.tolist())
    # Blender's own single-precision values, so that an unmoved object is exported exactly.
    ob[_IMPORT_MATRIX] = matrix_to_numpy(ob.matrix_basis).ravel().tolist()


def note_of_up(ob: bpy.types.Object, world: str) -> tuple[str, ...]:
    """Comment with the up axis of an export, for importing it again; empty in the world of photos,
    which the capture's alignment rotates."""
    if world == BLENDER:
        return (_BLENDER_NOTE,)
    if root_of(ob) is not None:
        return ()
    matrix = source_matrix(ob)
    named = (up for up, turn in UP_AXES.items() if np.allclose(matrix, turn, atol=1e-5))
    return tuple(f"{UP_NOTE}{up}" for up in named if up != _USUAL_UP)


def source_matrix(ob: bpy.types.Object) -> np.ndarray:
    """[4, 4] float64 from the world of the object's photos, or of its file, to Blender's.

    Raises:
        ValueError: the capture's empty has a scale of 0.
    """
    root = root_of(ob)
    if root is None:
        stored = ob.get(_IMPORT_MATRIX)
        return np.eye(4) if stored is None else np.array(stored, np.float64).reshape(4, 4)
    matrix = matrix_to_numpy(root.matrix_world)
    if not abs(np.linalg.det(matrix[:3, :3])) > 1e-30:
        raise ValueError(f"{root.name} has a scale of 0; reset its alignment.")
    return matrix


def source_matrix_of_data(ob: bpy.types.Object) -> np.ndarray:
    """[4, 4] float64 from the object's data to its source's world.

    Exactly the identity for an unmoved object, so that its values are exported unchanged.
    """
    root = root_of(ob)
    if root is not None and ob.parent == root and ob.parent_type == "OBJECT" and not ob.constraints:
        matrix = local_matrix(ob)
    else:
        matrix = np.linalg.inv(source_matrix(ob)) @ matrix_to_numpy(ob.matrix_world)
    return np.eye(4) if np.abs(matrix - np.eye(4)).max() < _NOISE else matrix
