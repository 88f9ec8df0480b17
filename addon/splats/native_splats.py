"""Native Gaussian splats of Blender (5.3): point clouds converted to splat objects."""

from functools import partial

import bpy
import numpy as np

from .. import attributes
from ..interface import editable_check
from ..interface.blocks import with_uid
from ..process.incremental_tasks import Check, Pieces, run_in_thread
from . import objects, settings
from .mesh_buffers import Points
from .read_chunked import read_chunked
from .write_chunked import ChunkedWrite, filled


def taking(cloud: bpy.types.Object) -> Pieces[bpy.types.Object]:
    """Create a splat object at a point cloud's location; the cloud is kept and hidden.

    Raises:
        ValueError: attributes are missing, the cloud was removed meanwhile, or values are not
            finite; nothing is left then.
    """
    name, uid = cloud.name, cloud.session_uid
    columns = yield from read_chunked(cloud)
    size = yield from run_in_thread(partial(_size, columns), f"Measuring {name}")
    yield from settings.building()
    [mesh] = yield from filled([ChunkedWrite(_points(columns))], partial(_cloud, uid, name))
    return _place(mesh, size, _cloud(uid, name))


def _cloud(uid: int, name: str) -> bpy.types.Object:
    cloud = with_uid(bpy.data.objects, uid)
    if cloud is None:
        raise ValueError(f"{name} was removed; its splats were not converted.")
    return cloud


def _size(columns: dict[str, np.ndarray], check: Check) -> float:
    """`objects.typical_size` of attributes."""
    sizes = columns[attributes.SCALE].max(axis=1, initial=0.0)
    return float(np.median(sizes)) if len(sizes) else 0.0


def _place(mesh: bpy.types.Mesh, size: float, cloud: bpy.types.Object) -> bpy.types.Object:
    mesh.name = f"{cloud.name} splats"
    collection = editable_check.taking(cloud.users_collection)[0]
    made = objects.around(mesh, size, collection=collection, parent=cloud.parent)
    made.matrix_parent_inverse = cloud.matrix_parent_inverse
    made.matrix_basis = cloud.matrix_basis
    cloud.hide_render = True
    for scene in bpy.data.scenes:
        objects.hide(cloud, scene)
    return made


def _points(columns: dict[str, np.ndarray]) -> Points:
    flat = tuple((n, attributes.kind_of(n), values.ravel()) for n, values in columns.items())
    return Points(count=len(columns[attributes.BASE]), columns=flat)
