"""Relight Splats: normals of splats, and the light in their photos, kept as attributes."""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import bpy
import numpy as np
from bpy.props import EnumProperty
from mathutils.kdtree import KDTree

from .. import attributes
from ..cameras.objects import cameras_of, local_matrix, root_of
from ..compat import matrix_to_numpy
from ..core import sh0_to_rgb
from ..process.incremental_tasks import Check, Steps, run_in_thread
from ..splats.edit_guard import EditGuard
from ..splats.edit_operators import Editing
from ..splats.objects import moved as moved_splats
from ..splats.objects import proxy_of
from ..splats.read_chunked import read_chunked
from ..srgb import decode
from ..triangles import moved, vertices_of
from . import relight
from .lamps import scene_light

SURFACES, SCENE = "SURFACES", "SCENE"
_CHUNK = 1 << 14
"""Splats between two checks for cancellation."""


class RelightSplats(Editing, bpy.types.Operator):
    """Let the scene's lamps and world light the splats: estimate their normals and the light in the
    photos, and replace that light. The slider Light fades between both"""

    bl_idname = "gscore.relight_splats"
    bl_label = "Relight Splats"

    captured: EnumProperty(
        name="Captured Light",
        description="Light in the photos",
        items=[
            (
                SURFACES,
                "From the Colors",
                "What the brightness of surfaces has in common by their direction; the brightest "
                "surfaces count as white",
            ),
            (
                SCENE,
                "As in the Scene",
                "The scene's lamps and world as they are now: Match Sun and World from Splats, or "
                "lamps like those of the place. Change them afterwards",
            ),
        ],
        default=SURFACES,
    )

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """Estimate in a thread, then store."""
        ob = guard.there()
        matrix, root, proxy = matrix_to_numpy(ob.matrix_world), root_of(ob), proxy_of(ob)
        moved_splats(attributes.NO_SPLATS, matrix, ob.name)  # raises unless it is a similarity
        cameras = [] if root is None else cameras_of(root)
        eyes = np.array([c.matrix_world.translation for c in cameras]).reshape(-1, 3)
        inverse = np.linalg.inv(matrix)
        light = None
        if self.captured == SCENE:
            light = scene_light(context.evaluated_depsgraph_get())
            light = replace(light, casters=light.casters.only_proxies)
        work = partial(
            _estimated,
            eyes=eyes @ inverse[:3, :3].T + inverse[:3, 3],
            surface=None if proxy is None else _surface(proxy),
            light=light,
            matrix=matrix,
        )
        columns = yield from read_chunked(ob)
        made = yield from run_in_thread(partial(work, columns), "Estimating surfaces and light")
        ob = guard.to_change()
        for name, values in zip((attributes.NORMAL, attributes.CAPTURED), made, strict=True):
            attributes.declare(ob.data, name, "FLOAT_VECTOR")
            attributes.fill(ob.data, name, "FLOAT_VECTOR", values.ravel())
        ob.data.update()
        ob.gscore.light = 1.0
        source = "their shortest axes" if proxy is None else proxy.name
        return f"{ob.name} is lit by the scene; its normals are those of {source}."


class _Surface(NamedTuple):
    """A mesh of the surface of splats."""

    places: np.ndarray
    """Vertices [V, 3] float32."""
    normals: np.ndarray
    """Unit vectors of these [V, 3] float32."""
    matrix: np.ndarray
    """[4, 4], to the space of the splats."""

    def placed(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices and normals in the space of the splats, [V, 3] each."""
        normals = self.normals @ np.linalg.inv(self.matrix[:3, :3])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        return moved(self.places, self.matrix), normals


def _surface(proxy: bpy.types.Object) -> _Surface:
    places = vertices_of(proxy.data)
    normals = np.empty_like(places)
    proxy.data.vertex_normals.foreach_get("vector", normals.ravel())
    return _Surface(places, normals, local_matrix(proxy))


def _estimated(
    columns: dict[str, np.ndarray],
    check: Check,
    *,
    eyes: np.ndarray,
    surface: _Surface | None,
    light: relight.SceneLight | None,
    matrix: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Normals, and captured light, [N, 3] float32 each; runs in a thread.

    Args:
        columns: Splat attributes.
        check: Raises after cancellation.
        eyes: Places of cameras [C, 3] in the object's space.
        surface: A mesh of the surface; None: there is none.
        light: The captured light; None: it is estimated.
        matrix: Object to world [4, 4].
    """
    means = columns[attributes.POSITION]
    base, scales = columns[attributes.BASE], columns[attributes.SCALE]
    weights = base[:, 3].astype(np.float64) * np.sort(scales, axis=1)[:, 1:].prod(axis=1)
    if surface is None or not len(surface.places):
        normals = relight.shortest_axes(columns[attributes.ROTATION], scales)
        seen = relight.facing(means, eyes)
        check()
        normals *= np.where(np.einsum("ij,ij->i", normals, seen) < 0, -1, 1)[:, None]
        normals = relight.smooth(means, normals, weights)
    else:
        normals = _nearest(means, *surface.placed(), check)
    check()
    if light is not None:
        return normals, light.white_of(means, normals, matrix)
    colors = decode(sh0_to_rgb(base[:, :3]))
    return normals, relight.captured_light(colors, normals, np.maximum(weights, 1e-30))


def _nearest(
    means: np.ndarray, places: np.ndarray, normals: np.ndarray, check: Check
) -> np.ndarray:
    """The normals [V, 3] of the nearest of some places [V, 3], for each mean [N, 3]."""
    tree = KDTree(len(places))
    for at, place in enumerate(places.tolist()):
        tree.insert(place, at)
    tree.balance()
    rows = np.empty(len(means), np.int64)
    for begin in range(0, len(means), _CHUNK):
        check()
        part = means[begin : begin + _CHUNK].tolist()
        rows[begin : begin + len(part)] = [tree.find(mean)[1] for mean in part]
    return normals[rows].astype(np.float32)
