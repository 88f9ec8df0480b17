"""Holdout meshes of a depsgraph: meshes that hide the splats behind them.

A holdout object hides splats with all instances that it makes, whatever their type. In an
instanced collection, a holdout object hides splats by itself too.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ..cameras.render_camera import RenderCamera
from ..core import Rendered, mesh_depth
from ..triangles import Triangles, joined, repeated, triangles_of
from . import compositing_scene, instances
from .instances import may_hold_out
from .picture import Window


@dataclass(frozen=True, kw_only=True)
class HoldoutMesh:
    """A mesh copied out of Blender."""

    triangles: Triangles
    """Triangles in object space."""
    matrices: np.ndarray
    """[K, 4, 4] float64, object to world, one per instance."""


def may_hide(ob: bpy.types.Object) -> bool:
    """Whether an object may hide splats by its faces or by those of its instances."""
    return may_hold_out(ob) or instances.may_grow(ob) or ob.instance_type == "COLLECTION"


def is_holdout(layer: bpy.types.ViewLayer, ob: bpy.types.Object) -> bool:
    """Whether an object is a holdout in a view layer, by itself or by its collection."""
    return ob.is_holdout or ob.original.holdout_get(view_layer=layer)


def holdouts_of(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Holdout objects of a scene, and the objects that their instances need."""
    layer = scene.view_layers[0]
    there = [ob for ob in layer.objects if ob is not None]  # 4.2 has None for removed objects
    found = [ob for ob in there if may_hide(ob) and is_holdout(layer, ob)]
    on_corners = {ob for ob in found if ob.instance_type in {"VERTS", "FACES"}}
    shown = (ob for ob in there if ob.parent in on_corners and "gs_kind" not in ob)
    return list(dict.fromkeys([*found, *shown]))


def missing_holdouts(main: bpy.types.Scene | None, splat_scene: bpy.types.Scene | None) -> str:
    """Names of holdout objects of a main scene that its splat-only scene does not have."""
    if main is None or splat_scene is None:
        return ""
    there = set(splat_scene.original.collection.objects)
    return ", ".join(ob.name for ob in holdouts_of(main) if ob not in there)


class HoldoutMeshes:
    """Copies of holdout meshes of similar depsgraphs, renewed when they change."""

    def __init__(self) -> None:
        self._known: dict[int, Triangles] = {}
        self._grown: dict[int, list[instances.Part]] = {}
        """Parts by object, in the space of their instancers."""
        self._walked: dict[instances.InstancerKey, list[instances.Part]] = {}
        """Generated parts by instancer, in world space."""

    def clear(self) -> None:
        """Drop all copies."""
        for kept in (self._known, self._grown, self._walked):
            kept.clear()

    def forget_changed(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Drop copies of data that a depsgraph update reports as changed."""
        for update in depsgraph.updates:
            # Any object may have been an instance.
            self._grown.clear()
            self._walked.clear()
            if update.is_updated_geometry and isinstance(update.id, bpy.types.Object):
                self._known.pop(update.id.original.session_uid, None)

    def of(
        self,
        depsgraph: bpy.types.Depsgraph,
        accepts: Callable[[bpy.types.Object, bpy.types.Object], bool] = lambda ob, shown_by: True,
    ) -> tuple[HoldoutMesh, ...]:
        """All holdout meshes of a depsgraph, with their instances.

        Args:
            depsgraph: Its visible objects.
            accepts: Predicate of an evaluated object and the object that shows it, possibly itself.
        """
        found, uids = [], set()
        instancers: set[instances.InstancerKey] = set()
        paths: set[instances.InstancerKey] = set()
        for shown_by, is_shown in _owners(depsgraph):
            for ob, matrix, path in instances.instances(shown_by, depsgraph, may_hide):
                if not (_cuts(ob, shown_by, depsgraph) and accepts(ob, shown_by)):
                    continue
                uid = ob.original.session_uid
                uids.add(uid)
                walker = shown_by.original.session_uid, path
                paths.add(walker)
                parts = []
                if instances.needs_walk(ob):
                    instancers.add(walker)
                elif instances.may_grow(ob):
                    if uid not in self._grown:
                        self._grown[uid] = instances.generated_instances(ob, depsgraph)
                    parts = self._grown[uid]
                itself = (is_shown or ob != shown_by) and may_hold_out(ob)
                grows = bool(parts) or instances.always_grows(ob)
                # Without Show Instancer it shows its instances in place of its own faces.
                if itself and (_shows_instancer(ob, depsgraph) or not grows):
                    parts = [self._own(ob), *parts]
                for triangles, places in parts:
                    if len(triangles.triangles):
                        found.append(HoldoutMesh(triangles=triangles, matrices=matrix @ places))
        if instancers - self._walked.keys():
            self._walked = instances.walked(depsgraph, instancers, paths)
        for walker in instancers:
            found += [HoldoutMesh(triangles=t, matrices=m) for t, m in self._walked[walker]]
        for uid in self._known.keys() - uids:
            del self._known[uid]
        return tuple(found)

    def _own(self, ob: bpy.types.Object) -> instances.Part:
        """The faces of an evaluated object without instances."""
        uid = ob.original.session_uid
        if uid not in self._known:
            self._known[uid] = triangles_of(ob)
        return self._known[uid], np.eye(4)[None]


def _owners(depsgraph: bpy.types.Depsgraph) -> Iterator[tuple[bpy.types.Object, bool]]:
    """Evaluated objects that a depsgraph shows itself or by instances, and whether itself."""
    known = set()
    for ob in depsgraph.objects:
        known.add(ob.original.session_uid)
        yield ob, True
    # They do not include instancers with Show Instancer off.
    for layer in _layers(depsgraph):
        for ob in layer.objects:
            if ob is None or ob.original.session_uid in known or not may_hide(ob):
                continue
            if not _shows_instancer(ob, depsgraph) and _is_on(ob.original, layer, depsgraph):
                yield ob.evaluated_get(depsgraph), False


def _layers(depsgraph: bpy.types.Depsgraph) -> Iterator[bpy.types.ViewLayer]:
    """The view layer of a depsgraph, and those that Blender uses of its background sets."""
    yield depsgraph.view_layer
    scene = depsgraph.scene.original.background_set
    while scene is not None:
        yield next((layer for layer in scene.view_layers if layer.use), scene.view_layers[0])
        scene = scene.background_set


def _is_on(
    ob: bpy.types.Object, layer: bpy.types.ViewLayer, depsgraph: bpy.types.Depsgraph
) -> bool:
    """Whether an original object of a view layer is visible."""
    if depsgraph.mode != "RENDER":
        return ob.visible_get(view_layer=layer)
    return not ob.hide_render and compositing_scene.is_rendered(ob, layer.layer_collection)


def _shows_instancer(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    render = depsgraph.mode == "RENDER"
    return ob.show_instancer_for_render if render else ob.show_instancer_for_viewport


def _cuts(ob: bpy.types.Object, shown_by: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    holdout = ob.is_holdout or shown_by.is_holdout
    if not (holdout or compositing_scene.is_held_out(shown_by.original, depsgraph)):
        return False
    if depsgraph.mode != "RENDER":
        return True
    visible = ob.visible_camera and shown_by.visible_camera
    return visible and compositing_scene.is_camera_visible(shown_by.original, depsgraph)


SHARED = HoldoutMeshes()
"""Copies for the viewports of this Blender session."""


_SAMPLES = 4
"""Samples along either side of a pixel at which meshes are rasterized."""
MOST_TRIANGLES = 20_000_000
"""Limit of the triangles of all holdout meshes, each instance counted."""
_AT_ONCE = 1 << 22
"""Samples of one band."""
_BLENDED = ("rgb", "alpha")
_PICTURES = (*_BLENDED, "depth", "inverse_depth", "median_depth")


@dataclass(frozen=True, kw_only=True)
class Hidden:
    """Parts of a picture that meshes hide."""

    share: np.ndarray
    """[H, W] float32, coverage of a pixel by meshes."""
    far: np.ndarray
    """[H, W] float32, z of the meshes that cover it; NaN: none."""

    def inside(self, window: Window | None) -> "Hidden":
        """The part in a window of the picture; None: everything."""
        if window is None:
            return self
        left, top, width, height = window
        part = (slice(top, top + height), slice(left, left + width))
        return Hidden(share=self.share[part], far=self.far[part])

    @property
    def edges(self) -> Window | None:
        """The smallest window with all partly covered pixels; None: there are none."""
        rows, columns = np.nonzero((self.share > 0) & (self.share < 1))
        if not len(rows):
            return None
        left, top = int(columns.min()), int(rows.min())
        return left, top, int(columns.max()) - left + 1, int(rows.max()) - top + 1


def hidden(meshes: Sequence[HoldoutMesh], camera: RenderCamera) -> Hidden:
    """The parts of a camera's picture that meshes hide, by 4 x 4 samples per pixel.

    Raises:
        ValueError: there are too many triangles.
    """
    count = sum(len(m.triangles.triangles) * len(m.matrices) for m in meshes)
    if count > MOST_TRIANGLES:
        raise ValueError(
            f"Holdout meshes have {count:,} triangles with all instances; the limit is "
            f"{MOST_TRIANGLES:,}. Use a simpler mesh as holdout."
        )
    mesh, height = joined([repeated(m.triangles, m.matrices) for m in meshes]), camera.height
    rows = max(1, _AT_ONCE // (_SAMPLES**2 * camera.width))
    bands = [slice(first, min(first + rows, height)) for first in range(0, height, rows)]
    share = np.zeros((height, camera.width), np.float32)
    far = np.full_like(share, np.nan)

    def sample(band: slice) -> None:
        share[band], far[band] = _sampled(mesh, camera, band)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(sample, bands))
    return Hidden(share=share, far=far)


def _sampled(mesh: Triangles, camera: RenderCamera, band: slice) -> tuple[np.ndarray, np.ndarray]:
    """`Hidden.share` and `far` of some rows."""
    K = camera.K.copy()
    K[1, 2] -= band.start
    K[:2] *= _SAMPLES
    inverse = mesh_depth(
        mesh.vertices,
        mesh.triangles,
        K,
        camera.viewmat,
        camera.width * _SAMPLES,
        (band.stop - band.start) * _SAMPLES,
        near=camera.near,
        orthographic=camera.orthographic,
    ).reshape(band.stop - band.start, _SAMPLES, camera.width, _SAMPLES)
    hits = (inverse > 0).sum((1, 3), dtype=np.float32)
    with np.errstate(invalid="ignore"):
        # The mean of inverse depths is that of a plane in the middle of the pixel.
        far = hits / inverse.sum((1, 3), dtype=np.float32)
    return hits / np.float32(_SAMPLES**2), far


def cut(covered: Rendered, free: Rendered | None, at: Hidden) -> tuple[Rendered, np.ndarray]:
    """A picture without background in which meshes hide the splats behind them.

    Args:
        covered: Picture of the splats in front of the meshes.
        free: Picture of all splats, in the window `at.edges`; None if that is None.
        at: The parts that meshes hide.

    Returns:
        The picture, with the depths of the larger part of each pixel; and [H, W] float32, the
        share of the background that still shows.
    """
    light = (1 - at.share) * (1 - covered.alpha)
    if free is None or at.edges is None:
        return covered, light
    left, top, width, height = at.edges
    part = (slice(top, top + height), slice(left, left + width))
    share = at.share[part]
    light[part] = (1 - share) * (1 - free.alpha)
    mixed = {name: getattr(covered, name) for name in _PICTURES}
    mixed = {name: picture.copy() for name, picture in mixed.items() if picture is not None}
    for name, picture in mixed.items():
        mine, other = picture[part], getattr(free, name)
        weight = (share if name in _BLENDED else np.round(share)).reshape(
            share.shape + (1,) * (mine.ndim - 2)
        )
        picture[part] = weight * mine + (1 - weight) * other
    return replace(covered, **mixed), light
