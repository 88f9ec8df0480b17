"""Fit of made proxies to their splats: cut where splats were removed, colored as they were painted.

A proxy stores how its vertices lay among the splats when it was made, and a fingerprint of these.
"""

import zlib
from functools import partial
from typing import NamedTuple

import bmesh
import bpy
import numpy as np
from mathutils.kdtree import KDTree

from .. import attributes
from ..cameras.objects import local_matrix
from ..core import sh0_to_rgb
from ..interface.base_operator import Condition
from ..interface.blocks import block_of
from ..interface.incremental_operator import IncrementalOperator
from ..process.incremental_tasks import Check, Steps, run_in_thread
from ..render.proxy import MADE
from ..splats.objects import active_splats, proxy_of
from ..splats.read_chunked import read_chunked
from ..triangles import moved, vertices_of
from .mesh_object import COLOR

_FITTED = "gs_fitted"
"""Custom property of a proxy: `fingerprint` of its splats when it was made or fitted."""
_DISTANCE, _SHADE = "gs_distance", "gs_shade"
"""Attributes of a proxy's vertices: distance to the nearest splat, and its color, at that time."""
_OPAQUE = 0.1
"""Least opacity of a splat that carries a surface."""
_CHUNK = 30_000
"""Splats per search tree, few enough to be built within a step."""
_FARTHER = 2.0
"""Growth of the distance to the nearest splat from which on a vertex has lost its splats."""
_known: dict[int, str] = {}
"""`fingerprint` by session uid of a mesh that has not changed since."""


def fingerprint(ob: bpy.types.Object) -> str:
    """Hash of positions, colors and opacities of splats; empty in Edit Mode, where they cannot be
    read. Quick enough for panels: it is kept until the mesh changes."""
    mesh = ob.data
    if mesh.is_editmode:
        return ""
    if mesh.session_uid not in _known:
        sums = [str(len(mesh.vertices))]
        for name, width in ((attributes.POSITION, 3), (attributes.BASE, 4)):
            if name in mesh.attributes:
                values = np.empty(width * len(mesh.vertices), np.float32)
                key = attributes.FORMATS[attributes.kind_of(name)][0]
                mesh.attributes[name].data.foreach_get(key, values)
                sums.append(f"{zlib.crc32(values):08x}")
        _known[mesh.session_uid] = "-".join(sums)
    return _known[mesh.session_uid]


@bpy.app.handlers.persistent
def _after_update(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Forget the fingerprints of changed meshes."""
    if _known and depsgraph is not None:
        for update in depsgraph.updates:
            if isinstance(update.id, bpy.types.Mesh):
                _known.pop(update.id.original.session_uid, None)


@bpy.app.handlers.persistent
def _forget(*_: object) -> None:
    _known.clear()


HANDLERS = {
    "depsgraph_update_post": _after_update,
    "undo_post": _forget,
    "redo_post": _forget,
    "load_post": _forget,
}


def is_stale(splats: bpy.types.Object) -> bool:
    """Whether splats have a made proxy, and were cut, moved, painted or replaced since."""
    proxy = proxy_of(splats)
    if proxy is None or _FITTED not in proxy:
        return False
    return fingerprint(splats) not in ("", proxy[_FITTED])


class _Near(NamedTuple):
    """Nearest opaque splats of some places."""

    distances: np.ndarray
    """[V] float32; infinite without splats."""
    colors: np.ndarray
    """[V, 3] float32 sRGB."""


def _near(places: np.ndarray, columns: dict[str, np.ndarray], check: Check) -> _Near:
    """The nearest splats of places [V, 3]; runs in a thread."""
    means, base = columns[attributes.POSITION], columns[attributes.BASE]
    rows = np.flatnonzero(base[:, 3] >= _OPAQUE)
    distances, nearest = np.full(len(places), np.inf, np.float32), np.zeros(len(places), np.int64)
    for begin in range(0, len(rows), _CHUNK):
        part = rows[begin : begin + _CHUNK]
        tree = KDTree(len(part))
        for at, mean in enumerate(means[part].tolist()):
            tree.insert(mean, at)
        tree.balance()
        check()
        for at, place in enumerate(places.tolist()):
            _, row, distance = tree.find(place)
            if distance < distances[at]:
                distances[at], nearest[at] = distance, part[row]
        check()
    colors = sh0_to_rgb(base[nearest, :3]) if len(rows) else np.zeros((len(places), 3))
    return _Near(distances, colors.astype(np.float32))


def _search(splats: bpy.types.Object, proxy: bpy.types.Object) -> Steps[_Near]:
    """The nearest splats of the vertices of a proxy; distances in its own space, so that Apply
    Splat Transform changes none."""
    places, matrix = vertices_of(proxy.data), local_matrix(proxy)
    if not abs(np.linalg.det(matrix[:3, :3])) > 1e-30:
        raise ValueError(f"{proxy.name} has a scale of 0: set its scale to 1 first.")
    columns = yield from read_chunked(splats, [attributes.POSITION, attributes.BASE])
    columns[attributes.POSITION] = moved(columns[attributes.POSITION], np.linalg.inv(matrix))
    return (yield from run_in_thread(partial(_near, places, columns), "Comparing with the splats"))


def note(splats: bpy.types.Object, proxy: bpy.types.Object) -> Steps[None]:
    """Store how a proxy that was just made lies among its splats."""
    uid, mark = proxy.session_uid, fingerprint(splats)
    near = yield from _search(splats, proxy)
    proxy = block_of(bpy.data.objects, uid, "The proxy was removed.")
    if len(near.distances) == len(proxy.data.vertices):
        _store(proxy, near, mark)


def _store(proxy: bpy.types.Object, near: _Near, mark: str) -> None:
    mesh = proxy.data
    for name, kind, values in (
        (_DISTANCE, "FLOAT", near.distances),
        (_SHADE, "FLOAT_VECTOR", near.colors.ravel()),
    ):
        attributes.declare(mesh, name, kind)
        attributes.fill(mesh, name, kind, values)
    proxy[_FITTED] = mark


def _floats(rows: bpy.types.bpy_prop_collection, key: str, width: int) -> np.ndarray:
    values = np.empty(width * len(rows), np.float32)
    rows.foreach_get(key, values)
    return values.reshape(-1, width) if width > 1 else values


def _fit(proxy: bpy.types.Object, near: _Near, mark: str) -> int:
    """Cut and color the mesh of a proxy; returns the number of removed faces."""
    mesh = proxy.data
    before = _floats(mesh.attributes[_DISTANCE].data, "value", 1)
    shift = near.colors - _floats(mesh.attributes[_SHADE].data, "vector", 3)
    places = vertices_of(mesh)
    ends = np.empty(2 * len(mesh.edges), np.int32)
    if len(ends):
        mesh.attributes[".edge_verts"].data.foreach_get("value", ends)
    edges = np.linalg.norm(places[ends[::2]] - places[ends[1::2]], axis=1)
    gone = near.distances > _FARTHER * before + float(np.median(edges))
    if (colors := mesh.color_attributes.get(COLOR)) is not None:
        added = np.where(gone[:, None], 0, shift)
        if colors.domain == "CORNER":  # as Blender's tools may convert it
            corners = np.empty(len(mesh.loops), np.int32)
            mesh.attributes[".corner_vert"].data.foreach_get("value", corners)
            added = added[corners]
        rgba = np.empty(4 * len(added), np.float32)
        colors.data.foreach_get("color_srgb", rgba)
        rgba = rgba.reshape(-1, 4)
        rgba[:, :3] += added
        colors.data.foreach_set("color_srgb", np.clip(rgba, 0, 1).ravel())
    _store(proxy, _Near(np.where(gone, before, near.distances), near.colors), mark)
    faces = len(mesh.polygons)
    if gone.any():
        _remove(mesh, gone)
    mesh.update()
    return faces - len(mesh.polygons)


def _remove(mesh: bpy.types.Mesh, gone: np.ndarray) -> None:
    made = bmesh.new()
    made.from_mesh(mesh)
    made.verts.ensure_lookup_table()
    verts = [made.verts[row] for row in np.flatnonzero(gone).tolist()]
    bmesh.ops.delete(made, geom=verts, context="VERTS")
    made.to_mesh(mesh)
    made.free()


def _has_made(context: bpy.types.Context) -> bool:
    splats = active_splats(context)
    proxy = None if splats is None else proxy_of(splats)
    return proxy is not None and MADE in proxy and _DISTANCE in proxy.data.attributes


class UpdateProxy(IncrementalOperator, bpy.types.Operator):
    """Cut the proxy where its splats were removed, and color it as they were painted"""

    bl_idname = "gscore.update_proxy"
    bl_label = "Update Proxy"
    needs = Condition(_has_made, "The active splats have no proxy made by Make Proxy")

    def changes(self, context: bpy.types.Context) -> tuple[bpy.types.ID, ...]:
        """The proxy and its mesh."""
        proxy = proxy_of(active_splats(context))
        return proxy, proxy.data

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Compare in a thread, then change the mesh."""
        splats = active_splats(context)
        proxy = proxy_of(splats)
        uid, mark = proxy.session_uid, fingerprint(splats)
        if not mark:
            raise ValueError(f"{splats.name} is in Edit Mode: leave it, then update its proxy.")
        near = yield from _search(splats, proxy)
        proxy = block_of(bpy.data.objects, uid, "The proxy was removed meanwhile.")
        if len(near.distances) != len(proxy.data.vertices):
            raise ValueError(f"{proxy.name} has changed meanwhile: press Update Proxy again.")
        if proxy.data.users > 1:  # copies of splats share the mesh of their proxies
            proxy.data = proxy.data.copy()
        cut = _fit(proxy, near, mark)
        return f"Removed {cut:,} of the faces of {proxy.name}."
