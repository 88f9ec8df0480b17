"""Scene splats: the splat objects that a depsgraph shows, copied out of Blender."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import Any, NamedTuple

import bmesh
import bpy
import numpy as np

from ..splats.filters import Filters, filters_of
from ..splats.objects import ANTIALIAS, can_export, chain, proxy_of
from ..timeline.frame_at import Moment, moment_of
from . import compositing_scene
from .instances import instances
from .lamps import scene_light
from .mesh_copies import HIDDEN, SELECTED, Frozen, FrozenMesh, freeze, read_marks
from .relight import Relighting, SceneLight

NO_SPLATS = (
    "There are no splats to render: import a splat PLY, or enable the splat object and its "
    "collection for renders."
)
NONE_IN_VIEW = (
    "There are no visible splats: show the splat object and its collection in the viewport."
)
_EDITED = threading.Lock()


class Identity(NamedTuple):
    """Identity of an object in mattes."""

    name: str
    asset: str
    """Name of its uppermost parent, or its own."""
    index: int
    """Pass Index."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """A splat object of a depsgraph with its placement; valid as long as the depsgraph is."""

    ob: bpy.types.Object
    """Evaluated."""
    matrix: np.ndarray
    """[4, 4] float64, object to world."""
    shown_by: bpy.types.Object
    """Evaluated object that decides about visibility in viewports: itself, or the instancer of its
    collection."""
    moment: Moment | None = None
    """The shown frame of a sequence; None: its own data are shown."""

    @property
    def is_camera_visible(self) -> bool:
        """Whether it is visible to camera rays."""
        return self.ob.visible_camera and compositing_scene.is_camera_visible(
            self.shown_by.original, self._depsgraph
        )

    @property
    def is_holdout(self) -> bool:
        """Whether it, or its collection, cuts a hole into the picture."""
        return self.ob.is_holdout or compositing_scene.is_held_out(
            self.shown_by.original, self._depsgraph
        )

    @property
    def identity(self) -> Identity:
        """Its identity in mattes."""
        return Identity(self.ob.name, chain(self.ob.original)[-1].name, self.ob.pass_index)

    @property
    def uid(self) -> int:
        """Session uid of the original data, or of the object if it plays a sequence."""
        original = self.ob.original
        return (original.data if self.moment is None else original).session_uid

    @property
    def data(self) -> Any:
        """The object's own evaluated data before its modifiers."""
        # The evaluated object has the result of modifiers, which for displays is instances.
        return self.ob.original.data.evaluated_get(self._depsgraph)

    @property
    def is_edited(self) -> bool:
        """Whether `data` are in Edit Mode, where their attributes cannot be read."""
        return bool(getattr(self.ob.original.data, "is_editmode", False))

    def frozen(self) -> Frozen:
        """A copy of all splat attributes, in Edit Mode too, or the frame of a sequence.

        Raises:
            ValueError: the frame cannot be read.
        """
        if self.moment is not None:
            return self.moment.frame()
        return self.frozen_mesh()

    def frozen_mesh(self) -> FrozenMesh:
        """A copy of the splat attributes of the object's own data."""
        if not self.is_edited:
            return freeze(self.data, self.ob.name)
        original = self.ob.original
        with _EDITED:  # an object has only one temporary mesh
            # F12 in a window runs in another thread, for which Blender has already flushed edits.
            if threading.current_thread() is threading.main_thread():
                original.update_from_editmode()
            try:
                return freeze(original.to_mesh(), self.ob.name)
            finally:
                original.to_mesh_clear()

    def marks(self) -> np.ndarray | None:
        """Selection and visibility. In Edit Mode they are read from the BMesh, because flushing
        them to the mesh would count as a change of it."""
        if not self.is_edited:
            return read_marks(self.data)
        verts = bmesh.from_edit_mesh(self.ob.original.data).verts
        bits = (SELECTED * v.select | HIDDEN * v.hide for v in verts)
        marks = np.fromiter(bits, np.uint8, len(verts))
        return marks if marks.any() else None

    light: Callable[[], SceneLight]
    """The light of the scene, computed once for all objects."""
    _depsgraph: bpy.types.Depsgraph
    """Evaluates `data`."""


@dataclass(frozen=True, kw_only=True)
class Placed:
    """A splat object copied out of Blender, usable without bpy."""

    identity: Identity = field(compare=False)
    uid: int
    """Session uid of its original mesh, or of the object if it plays a sequence."""
    frozen: Frozen
    matrix: np.ndarray
    """[4, 4] float64, object to world."""
    filters: Filters | None
    """Filters of its splats; None: all are drawn."""
    antialias: bool
    edited: bool = False
    """Whether it is in Edit Mode, where hidden points are not drawn."""
    holdout: bool = False
    """Whether it cuts a hole into the picture."""
    relighting: Relighting | None = None
    """The light that replaces the captured one; None: it does not."""

    @property
    def name(self) -> str:
        """Name of the object."""
        return self.identity.name

    @property
    def part(self) -> tuple[int, bytes]:
        """Key that is equal for objects with the same mesh, filters and light."""
        uid, filters = self.captured
        return uid, filters if self.relighting is None else filters + self.relighting.key

    @property
    def captured(self) -> tuple[int, bytes]:
        """Key that is equal for objects with the same mesh and filters."""
        if self.filters is None:
            return self.uid, b""
        crop = b"" if self.filters.crop is None else self.filters.crop.tobytes()
        return self.uid, crop + repr(replace(self.filters, crop=None)).encode()


def sources(depsgraph: bpy.types.Depsgraph) -> list[Source]:
    """The visible splat objects of a depsgraph, including those in collection instances."""
    found, light = [], cache(partial(scene_light, depsgraph))
    for ob in depsgraph.objects:  # without objects hidden or excluded in the depsgraph's mode
        shown = instances(ob, depsgraph, can_export)
        found += [_source(o, m, ob, depsgraph, light) for o, m, _ in shown]
    if depsgraph.mode == "RENDER":
        return [source for source in found if source.is_camera_visible]
    return found


def _source(
    ob: bpy.types.Object,
    matrix: np.ndarray,
    shown_by: bpy.types.Object,
    depsgraph: bpy.types.Depsgraph,
    light: Callable[[], SceneLight],
) -> Source:
    edited = bool(getattr(ob.original.data, "is_editmode", False))
    wait = bpy.app.background or depsgraph.mode == "RENDER"
    moment = moment_of(ob, depsgraph.scene.frame_current_final, wait=wait)
    return Source(
        ob=ob,
        matrix=matrix,
        shown_by=shown_by,
        moment=None if edited else moment,  # Edit Mode shows the mesh
        light=light,
        _depsgraph=depsgraph,
    )


def place(
    source: Source,
    frozen: Frozen | None = None,
    *,
    always_filtered: bool = False,
    captured: bool = False,
) -> Placed:
    """Copy the data of an object that rendering needs.

    Args:
        source: The object.
        frozen: Its attributes, if they have been copied already.
        always_filtered: Apply its filters even if they are off for renders.
        captured: Leave out the light of the scene.

    Raises:
        ValueError: attributes are missing; they are named.
    """
    ob = source.ob
    frozen = source.frozen() if frozen is None else frozen
    settings = getattr(ob, "gscore", None)
    filtered = settings is not None and (always_filtered or settings.apply_filters_to_render)
    filters = filters_of(ob) if filtered else None
    if filters is not None and not filters.leave_out_anything:
        filters = None
    relighting = None if captured else _relighting(source, frozen)
    return Placed(
        identity=source.identity,
        uid=source.uid,
        frozen=frozen,
        matrix=source.matrix,
        filters=filters,
        antialias=bool(ob.get(ANTIALIAS, False)),
        edited=source.is_edited,
        holdout=source.is_holdout,
        relighting=relighting,
    )


def _relighting(source: Source, frozen: Frozen) -> Relighting | None:
    """`Placed.relighting` of an object, by its attributes."""
    settings = getattr(source.ob, "gscore", None)
    share = 0.0 if settings is None else settings.light
    share = share if isinstance(frozen, FrozenMesh) and frozen.can_be_relit else 0.0
    catches = proxy_of(source.ob.original) is not None and bool(source.light().casters.meshes)
    if not (share > 0 or catches):
        return None
    return Relighting(share=share, catches=catches, light=source.light(), matrix=source.matrix)
