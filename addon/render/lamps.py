"""Lamps and world of a scene, as light for splats."""

import zlib
from functools import lru_cache

import bpy
import numpy as np

from ..compat import matrix_to_numpy, rec709_to_scene, world_nodes
from ..core import POINT, SUN, Lamp
from ..splats.objects import is_proxy, is_splats
from ..srgb import decode
from ..triangles import Triangles, triangles_of
from . import relight
from .color import world_light, world_of
from .compositing_scene import is_rendered, main_scene
from .instances import instances, may_hold_out
from .relight import SceneLight
from .shadow_maps import Casters, ball_of

_GRID = 2
"""Points of an area lamp along each side."""
_WIDEST = np.radians(120)
"""Largest angle of a sun in soft shadows."""
_LARGEST_MAP = 1 << 21
"""Pixels of an environment texture above which the world's color is used."""
_ROWS = 64
"""Rows to which an environment texture is reduced."""
_SAMPLES = 4
"""Samples of a texture of bytes along each side of a reduced pixel."""


def scene_light(depsgraph: bpy.types.Depsgraph) -> SceneLight:
    """The visible lamps and meshes of a depsgraph, and its world.

    In a splat-only scene, those lamps that the main scene shows, its world, and its proxies: the
    shadow scene has the shadows of other meshes, but not of proxies on each other.
    """
    lamps: list[Lamp] = []
    meshes: list[bpy.types.Object] = []
    main = main_scene(depsgraph.scene)
    top = None if main is None else main.view_layers[0].layer_collection
    corners: list[np.ndarray] = []
    for ob in depsgraph.objects:
        if top is not None and not is_rendered(ob.original, top):
            continue
        for splats, matrix, _ in instances(ob, depsgraph, is_splats):
            box = np.array([tuple(corner) for corner in splats.original.bound_box])
            corners.append(box @ matrix[:3, :3].T + matrix[:3, 3])
        if ob.type == "LIGHT":
            lamps += _lamps_of(ob)
        elif may_hold_out(ob) and ob.visible_shadow and not ob.is_shadow_catcher:
            meshes += [ob] if main is None or is_proxy(ob) else []
    world = world_of(depsgraph.scene, depsgraph.view_layer) if main is None else main.world
    around = light_of_world(world)
    casters = _casters(meshes, corners, depsgraph) if lamps or around.any() else Casters()
    return SceneLight(lamps=tuple(lamps), world=around, casters=casters)


_copies: dict[int, tuple[bytes, Triangles] | None] = {}
"""Checksum and triangles of each mesh object of the viewport, by session uid; None: it has none, or
vertices that are not finite."""


def _casters(
    meshes: list[bpy.types.Object], corners: list[np.ndarray], depsgraph: bpy.types.Depsgraph
) -> Casters:
    """Meshes that cast shadows. Renders copy them anew: no handler has their changes, and they run
    in a thread of their own."""
    copies = {} if depsgraph.mode == "RENDER" else _copies
    keys: dict[bool, list[bytes]] = {True: [], False: []}
    found: dict[bool, list[tuple[Triangles, np.ndarray]]] = {True: [], False: []}
    for ob in meshes:
        uid = ob.original.session_uid
        if uid not in copies:
            copy = triangles_of(ob)
            sums = (zlib.crc32(np.ascontiguousarray(values)) for values in copy)
            checksum = b"".join(one.to_bytes(4) for one in sums)
            usable = len(copy.triangles) and np.isfinite(copy.vertices).all()
            copies[uid] = (checksum, copy) if usable else None
        if copies[uid] is not None:
            checksum, triangles = copies[uid]
            matrix = matrix_to_numpy(ob.matrix_world)
            keys[is_proxy(ob)].append(checksum + matrix.tobytes())
            found[is_proxy(ob)].append((triangles, matrix))
    ball, place = ball_of(np.concatenate(corners)) if corners else None, b""
    if ball is not None and np.isfinite(ball[1]):
        place = np.append(*ball).tobytes()
    else:
        ball = None
    return _known_casters(
        Casters(
            proxy_key=b"".join(keys[True]) + place,
            mesh_key=b"".join(keys[False]) + place,
            proxies=tuple(found[True]),
            meshes=tuple(found[False]),
            splats=ball,
        )
    )


@lru_cache(maxsize=1)
def _known_casters(casters: Casters) -> Casters:
    """The last equal ones, whose mesh and ball are computed."""
    return casters


@bpy.app.handlers.persistent
def _after_update(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Forget copies of changed meshes, and the light of changed worlds."""
    for update in () if depsgraph is None or not (_copies or _known) else depsgraph.updates:
        if update.is_updated_geometry and isinstance(update.id, bpy.types.Object):
            _copies.pop(update.id.original.session_uid, None)
        elif isinstance(update.id, bpy.types.World):  # changed images tag it
            _known.clear()


@bpy.app.handlers.persistent
def _forget(*_: object) -> None:
    _copies.clear()
    _known.clear()
    _known_casters.cache_clear()


@bpy.app.handlers.persistent
def _loaded(*_: object) -> None:
    _forget()
    relight.forget_maps()


HANDLERS = {
    "depsgraph_update_post": _after_update,
    "frame_change_post": _after_update,
    "undo_post": _forget,
    "redo_post": _forget,
    "load_post": _loaded,
}


def _lamps_of(ob: bpy.types.Object) -> list[Lamp]:
    data, matrix = ob.data, matrix_to_numpy(ob.matrix_world)
    color = np.array(data.color, np.float64) * data.energy * 2.0 ** getattr(data, "exposure", 0)
    if getattr(data, "use_temperature", False):
        color *= np.array(data.temperature_color)
    color = np.linalg.solve(rec709_to_scene(), color)
    length = np.linalg.norm(matrix[:3, 2])
    if data.type != "POINT" and not length > 0:
        return []  # a scale of 0: it shines nowhere
    axis = -matrix[:3, 2] / max(length, 1e-12)
    place = tuple(matrix[:3, 3].tolist())
    common = {"axis": tuple(axis.tolist()), "source": place if data.use_shadow else None}
    if data.type == "SUN":
        size = float(np.tan(min(data.angle, _WIDEST) / 2))
        return [Lamp(kind=SUN, strength=tuple((color / np.pi).tolist()), size=size, **common)]
    common["kind"] = POINT
    if data.type == "AREA":
        # As many points that shine with the cosine: the flux is pi times the intensity ahead.
        strength = tuple((color / np.pi**2 / _GRID**2).tolist())
        sides = np.array([data.size, data.size_y if "RECT" in data.shape else data.size])
        if data.shape == "ELLIPSE":
            sides[1] = data.size_y
        if not getattr(data, "normalize", True):
            strength = tuple((np.array(strength) * float(sides.prod())).tolist())
        steps = (np.arange(_GRID) + 0.5) / _GRID - 0.5
        if data.shape in {"DISK", "ELLIPSE"}:
            steps *= np.sqrt(np.pi) / 2  # a square of the same area
        x, y = (grid.ravel() for grid in np.meshgrid(steps * sides[0], steps * sides[1]))
        places = matrix[:3, 3] + np.outer(x, matrix[:3, 0]) + np.outer(y, matrix[:3, 1])
        least = float(sides.max()) / _GRID / 2
        round_ = np.pi / 4 if data.shape in {"DISK", "ELLIPSE"} else 1.0
        area = round_ * sides.prod() * np.linalg.norm(matrix[:3, :2], axis=0).prod()
        common["size"] = float(np.sqrt(area / np.pi))  # a disc of the same area
        return [
            Lamp(strength=strength, place=tuple(p), radius=least, is_surface=True, **common)
            for p in places.tolist()
        ]
    strength = tuple((color / (4 * np.pi**2)).tolist())
    radius = float(data.shadow_soft_size)
    if data.type == "SPOT":
        edge = float(np.cos(data.spot_size / 2))
        common["cone"] = (edge, (1 - edge) * data.spot_blend)
    return [Lamp(strength=strength, place=place, radius=radius, size=radius, **common)]


def light_of_world(world: bpy.types.World | None) -> np.ndarray:
    """`SceneLight.world`: of the first environment texture if the world has one, else its color."""
    tree = None if world is None else world_nodes(world)
    nodes = () if tree is None else tree.nodes
    node = next((n for n in nodes if n.type == "TEX_ENVIRONMENT" and n.image is not None), None)
    if node is not None and 0 < node.image.size[0] * node.image.size[1] <= _LARGEST_MAP:
        links = node.outputs[0].links
        shader = links[0].to_node if links else None
        is_shown = shader is not None and shader.type == "BACKGROUND"
        strength = shader.inputs["Strength"].default_value if is_shown else 1.0
        return strength * _of_image(node.image)
    light = np.linalg.solve(rec709_to_scene(), world_light(world)[0])
    return relight.even_world(light)


_known: dict[tuple[int, int, int], np.ndarray] = {}
"""Light of the last environment texture by its session uid and size."""


def _of_image(image: bpy.types.Image) -> np.ndarray:
    key = image.original.session_uid, *image.size
    found = _known.get(key)
    if found is None:
        width, height = image.size
        pixels = np.empty(width * height * image.channels, np.float32)
        image.original.pixels.foreach_get(pixels)
        pixels = pixels.reshape(height, width, -1)
        step = max(height // _ROWS, 1)
        if not image.is_float and image.colorspace_settings.name == "sRGB":
            some = max(step // _SAMPLES, 1)  # bytes have no lamps that could be missed
            pixels, step = decode(pixels[::some, ::some]), max(step // some, 1)
        rows, columns = (size // step for size in pixels.shape[:2])
        light = pixels[: rows * step].reshape(rows, step, -1).mean(1)  # first, as it is fast
        light = light.reshape(rows, -1, image.channels)[:, : columns * step]
        light = light.reshape(rows, columns, step, -1).mean(2)[..., :3]
        size = rows, columns
        found = relight.world_of_map(
            light, relight.map_directions(*size), relight.map_solid_angles(*size)
        )
        _known.clear()
        _known[key] = found
    return found
