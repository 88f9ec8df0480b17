"""Sequence mesh: the mesh of an object that plays a sequence, its current frame and edited state.

The add-on's renderers take frames from memory. The mesh is for everything else: EEVEE and Cycles,
the node displays, Edit Mode, counts, exports.
"""

import zlib
from collections.abc import Sequence

import bpy
import numpy as np

from .. import attributes
from ..splats import copy_metadata, objects
from ..splats.point_attributes import copy_values, empty_values
from ..splats.write_chunked import check_replaceable, replace
from .frames import FrameFile
from .library import Frame

_HOLDS, _MARK = "gs_frame", "gs_frame_mark"
"""Custom properties of a mesh: label of its frame, and `mark_of` the unedited frame."""
_COMPARED = (attributes.POSITION, attributes.BASE)
"""Attributes compared to detect edits; all of them would take five times as long."""
_COMPARED_TYPES = {"FLOAT_VECTOR", "FLOAT_COLOR", "FLOAT4"}


def file_label(ob: bpy.types.Object) -> str:
    """`FrameFile.label` of the frame in an object's mesh; empty if unknown."""
    return str(ob.data.get(_HOLDS, ""))


def fill_mesh(ob: bpy.types.Object, frame: Frame) -> None:
    """Write a frame to an object's own mesh.

    Raises:
        ValueError: as `objects.refresh`.
    """
    objects.check_refreshable(ob)
    if _is_shared(ob.data):  # other objects may show other frames
        ob.data = ob.data.copy()
    objects.refresh(ob, frame.splats)
    note(ob.data, frame.file)


def note(mesh: bpy.types.Mesh, file: FrameFile, mark: str = "") -> None:
    """Store the frame label and mark of a mesh.

    Args:
        mesh: A mesh that was just filled.
        file: File of the frame.
        mark: `mark_of` its columns if known; empty: the mesh is read.
    """
    mesh[_HOLDS], mesh[_MARK] = file.label, mark or _mark_now(mesh)


def mark_of(columns: Sequence[tuple[str, str, np.ndarray]]) -> str:
    """Checksum that changes if splats are deleted, added, moved or coloured.

    Args:
        columns: As from `attributes.columns`.
    """
    by_name = {name: (kind, values) for name, kind, values in columns if len(values)}
    found = [by_name.get(name, ("", np.empty(0, np.float32))) for name in _COMPARED]
    return " ".join(f"{kind}:{len(values)}:{zlib.crc32(values):08x}" for kind, values in found)


def exchange(ob: bpy.types.Object, mesh: bpy.types.Mesh) -> None:
    """Replace an object's mesh; other users of the old one keep it.

    Raises:
        ValueError: as `write_chunked.replace`.
    """
    old = ob.data
    if not _is_shared(old):
        replace(ob, mesh)
        return
    check_replaceable(ob)
    copy_metadata.copy_user_data(old, mesh)
    ob.data = mesh
    mesh.name = old.name


def forget(mesh: bpy.types.Mesh) -> None:
    """Remove the frame label of a mesh."""
    for key in (_HOLDS, _MARK):
        mesh.pop(key, None)


def was_edited(ob: bpy.types.Object) -> bool:
    """True if an object's mesh differs from its loaded frame; False in Edit Mode."""
    mark = ob.data.get(_MARK, "")
    return bool(mark) and ob.mode != "EDIT" and mark != _mark_now(ob.data)


def _is_shared(mesh: bpy.types.Mesh) -> bool:
    """Whether a mesh has several users, not counting a fake user."""
    return mesh.users - mesh.use_fake_user > 1


def _mark_now(mesh: bpy.types.Mesh) -> str:
    """`mark_of` a mesh's current data; 2 ms for 100,000 splats."""
    columns = []
    for name in _COMPARED:
        found = mesh.attributes.get(name)
        if found is not None and found.data_type in _COMPARED_TYPES and len(found.data):
            values = empty_values(found.data_type, len(found.data))
            copy_values(mesh, name, values)
            columns.append((name, found.data_type, values.ravel()))
    return mark_of(columns)
