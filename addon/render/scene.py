"""From the objects of a depsgraph to one model of splats, remembered between pictures."""

import threading
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import bmesh
import bpy
import numpy as np

from .. import attributes
from ..core import Splats, transform_splats
from ..interface.flags import error_words
from ..splats.filters import Filters, filters_of
from ..splats.objects import ANTIALIAS, chain, is_native, is_splats
from ..timeline.moment import Moment, moment_of
from . import apart
from .frozen import HIDDEN, SELECTED, Frozen, FrozenMesh, freeze, read_marks
from .holdout import held_out
from .instances import instances
from .trace import Trace, repainted_rows, trace_of

NO_SPLATS = (
    "There are no splats to render: import a splat PLY, or enable the splat object and its "
    "collection for renders."
)
NONE_IN_VIEW = (
    "There are no splats to be seen: show the splat object and its collection in the viewport."
)
_EDITED = threading.Lock()


@dataclass(frozen=True, kw_only=True)
class Source:
    """A splat object as a depsgraph places it; valid as long as the depsgraph is."""

    ob: bpy.types.Object
    """Evaluated."""
    matrix: np.ndarray
    """[4, 4] float64 to the world."""
    shown_by: bpy.types.Object
    """Evaluated object by which a viewport decides whether to show it: itself, or the one that
    instances its collection."""
    moment: Moment | None = None
    """Which frame it shows, where it plays a sequence; else its own data are shown."""

    @property
    def is_seen(self) -> bool:
        """Whether the camera sees it, not only light that others throw."""
        return self.ob.visible_camera and apart.is_seen(self.shown_by.original, self._depsgraph)

    @property
    def is_holdout(self) -> bool:
        """Whether it, or its collection, cuts a hole into the picture."""
        return self.ob.is_holdout or apart.is_held_out(self.shown_by.original, self._depsgraph)

    @property
    def uid(self) -> int:
        """Of what is shown, the original data or an object that plays; the same as long as Blender
        runs."""
        original = self.ob.original
        return (original.data if self.moment is None else original).session_uid

    @property
    def data(self) -> Any:
        """The object's own data before its modifiers, as the depsgraph sees it."""
        # A mesh's evaluated object shows what modifiers made of it; the display makes instances.
        return self.ob.original.data.evaluated_get(self._depsgraph)

    @property
    def is_edited(self) -> bool:
        """Whether `data` are in Edit Mode, where their attributes are out of reach."""
        return bool(getattr(self.ob.original.data, "is_editmode", False))

    def frozen(self) -> Frozen:
        """A copy of all splat attributes, in Edit Mode too; of a sequence, its frame.

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
        with _EDITED:  # an object has one such mesh, whoever asks for it
            # In the program F12 draws in another thread, for which Blender has taken edits over.
            if threading.current_thread() is threading.main_thread():
                original.update_from_editmode()
            try:
                return freeze(original.to_mesh(), self.ob.name)
            finally:
                original.to_mesh_clear()

    def marks(self) -> np.ndarray | None:
        """What is selected and hidden. Those of a mesh in Edit Mode are looked at in the editor: to
        take them over into the mesh would count as a change of it."""
        if not self.is_edited:
            return read_marks(self.data)
        verts = bmesh.from_edit_mesh(self.ob.original.data).verts
        bits = (SELECTED * v.select | HIDDEN * v.hide for v in verts)
        marks = np.fromiter(bits, np.uint8, len(verts))
        return marks if marks.any() else None

    _depsgraph: bpy.types.Depsgraph
    """Gives `data`."""


class Identity(NamedTuple):
    """How mattes know an object."""

    name: str
    asset: str
    """The name of the uppermost of its parents, or its own."""
    index: int
    """Its Pass Index."""


@dataclass(frozen=True, kw_only=True)
class Placed:
    """A splat object copied out of Blender: needs no bpy any more."""

    identity: Identity
    uid: int
    """Of its original mesh, or of an object that plays a sequence; the same as long as Blender
    runs."""
    frozen: Frozen
    matrix: np.ndarray
    """[4, 4] float64 to the world."""
    filters: Filters | None
    """What is drawn of it; None: everything."""
    antialias: bool
    edited: bool = False
    """Whether it is in Edit Mode, where hidden points do not show."""
    holdout: bool = False
    """Whether it cuts a hole into the picture where it is."""

    @property
    def name(self) -> str:
        """The object's."""
        return self.identity.name

    @property
    def part(self) -> tuple[int, bytes]:
        """The same for two objects of the same mesh and filters."""
        if self.filters is None:
            return self.uid, b""
        crop = b"" if self.filters.crop is None else self.filters.crop.tobytes()
        return self.uid, crop + repr(replace(self.filters, crop=None)).encode()


@dataclass(frozen=True, kw_only=True)
class Model:
    """All splats of a picture."""

    splats: Splats
    """In the space of the object with the most splats, which so needs no transformation."""
    matrix: np.ndarray
    """[4, 4] float64, similarity from that space to the world."""
    antialias: tuple[str, ...]
    """Names of the objects that were trained with anti-aliasing."""
    plain: tuple[str, ...]
    """Names of the others."""
    owners: tuple[tuple[Identity | None, int], ...] = ()
    """Whose `splats` are, so many in a row each; None: of what is held out."""
    shares: Splats | None = None
    """Where objects are held out, whose `splats` are black then: the same splats, those black and
    all others white, which so draw how much of the light is not cut out."""


def sources(depsgraph: bpy.types.Depsgraph) -> list[Source]:
    """The splat objects that a depsgraph shows, those in collection instances too."""
    found = []
    for ob in depsgraph.objects:  # leaves out what is hidden or excluded for the depsgraph's mode
        found += [_source(o, m, ob, depsgraph) for o, m in instances(ob, depsgraph, _may_show)]
    if depsgraph.mode == "RENDER":
        return [source for source in found if source.is_seen]
    return found


def _source(
    ob: bpy.types.Object,
    matrix: np.ndarray,
    shown_by: bpy.types.Object,
    depsgraph: bpy.types.Depsgraph,
) -> Source:
    edited = bool(getattr(ob.original.data, "is_editmode", False))
    wait = bpy.app.background or depsgraph.mode == "RENDER"
    moment = moment_of(ob, depsgraph.scene.frame_current_final, wait=wait)
    return Source(
        ob=ob,
        matrix=matrix,
        shown_by=shown_by,
        moment=None if edited else moment,  # what is edited is the mesh
        _depsgraph=depsgraph,
    )


def place(source: Source, frozen: Frozen | None = None) -> Placed:
    """Copy what is needed of an object.

    Args:
        source: The object.
        frozen: Its attributes, where they have been copied already.

    Raises:
        ValueError: attributes are missing; they are named.
    """
    ob = source.ob
    frozen = source.frozen() if frozen is None else frozen
    settings = getattr(ob, "gscore", None)
    filtered = settings is not None and settings.apply_filters_to_render
    filters = filters_of(ob) if filtered else None
    if filters is not None and not filters.leave_out_anything:
        filters = None
    return Placed(
        identity=Identity(ob.name, chain(ob.original)[-1].name, ob.pass_index),
        uid=source.uid,
        frozen=frozen,
        matrix=source.matrix,
        filters=filters,
        antialias=bool(ob.get(ANTIALIAS, False)),
        edited=source.is_edited,
        holdout=source.is_holdout,
    )


def marks_of(placed: Placed, *, selected: bool) -> np.ndarray | None:
    """[N] uint8 marks of the splats that are drawn of an object, or None where none has any.

    Args:
        placed: The object. Its hidden points count in Edit Mode alone, as those of meshes do.
        selected: Whether those that are selected count.
    """
    wanted = SELECTED * selected | HIDDEN * placed.edited
    if placed.frozen.marks is None or not wanted:
        return None
    marks = placed.frozen.marks & np.uint8(wanted)
    if not marks.any():
        return None
    return marks if placed.filters is None else marks[placed.frozen.kept(placed.filters)]


class SplatCache:
    """Decoded splats by object, and the last model made of them. May be used from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._parts: dict[tuple[int, bytes], tuple[Trace, Splats]] = {}
        self._merged: tuple[list[tuple[Splats, np.ndarray]], Splats] | None = None
        self._held: tuple[Splats, list[tuple[int, bool]], tuple[Splats, Splats]] | None = None
        self.decoded = 0
        """How many times an object has been decoded, for measuring."""
        self.merged = 0
        """How many times several objects have been brought into one space."""

    def clear(self) -> None:
        """Let go of everything."""
        with self._lock:
            self._parts, self._merged, self._held = {}, None, None

    def model(self, placed: list[Placed]) -> Model:
        """One model of all objects; only what has changed since the last call is computed.

        Raises:
            ValueError: attributes are missing or not finite, or an object is scaled unevenly; the
                object is named.
        """
        with self._lock:
            parts = self._decoded(placed)
            base = max(placed, key=lambda p: len(parts[p.part]))
            inverse = np.linalg.inv(base.matrix)
            turned = [
                (parts[p.part], np.eye(4) if p is base else inverse @ p.matrix) for p in placed
            ]
            splats, shares = self._merge(turned), None
            counts = [len(parts[p.part]) for p in placed]
            if any(p.holdout for p in placed):
                runs = [(n, p.holdout) for n, p in zip(counts, placed, strict=True)]
                splats, shares = self._hold_out(splats, runs)
        owners = [None if p.holdout else p.identity for p in placed]
        return Model(
            splats=splats,
            owners=tuple(zip(owners, counts, strict=True)),
            shares=shares,
            matrix=base.matrix,
            antialias=tuple(p.name for p in placed if p.antialias),
            plain=tuple(p.name for p in placed if not p.antialias),
        )

    def parts(self, placed: list[Placed]) -> list[Splats]:
        """The splats of each object in its own space; errors as `model`."""
        with self._lock:
            found = self._decoded(placed)
        return [found[p.part] for p in placed]

    def _decoded(self, placed: list[Placed]) -> dict[tuple[int, bytes], Splats]:
        """By `Placed.part`; what is not asked for is forgotten."""
        for p in placed:
            check_similar(p)
        parts = {p.part: self._decode(p) for p in placed}
        self._parts = {key: known for key, known in self._parts.items() if key in parts}
        return parts

    def _decode(self, placed: Placed) -> Splats:
        known = self._parts.get(placed.part)
        if known is not None and known[0].fingerprint == placed.frozen.fingerprint:
            return known[1]
        made = None if known is None else _repainted(*known, placed)
        if made is None:
            made = _read(placed)
            self.decoded += 1
        self._parts[placed.part] = made
        return made[1]

    def _hold_out(self, splats: Splats, runs: list[tuple[int, bool]]) -> tuple[Splats, Splats]:
        """`Model.splats` and `shares`, of splats of which so many each are held out or not."""
        if self._held is None or self._held[0] is not splats or self._held[1] != runs:
            self._held = splats, runs, held_out(splats, runs)
        return self._held[2]

    def _merge(self, turned: list[tuple[Splats, np.ndarray]]) -> Splats:
        """Splats, each with the matrix to the common space, as one model."""
        if len(turned) == 1:
            self._merged = None
            return turned[0][0]
        same = self._merged is not None and len(self._merged[0]) == len(turned)
        if same:
            pairs = zip(self._merged[0], turned, strict=True)
            same = all(a is b and np.array_equal(m, n) for (a, m), (b, n) in pairs)
        if not same:
            moved = [s if np.array_equal(m, np.eye(4)) else _moved(s, m) for s, m in turned]
            self._merged = turned, _concatenated(moved)
            self.merged += 1
        return self._merged[1]


def _read(placed: Placed) -> tuple[Trace, Splats]:
    """The splats of an object that pass its filters, and what to remember of it."""
    splats, kept = placed.frozen.read(), None
    if placed.filters is not None:
        kept = placed.frozen.kept(placed.filters)
        splats = splats.subset(kept)
    return trace_of(placed.frozen, kept), splats


def _repainted(before: Trace, splats: Splats, placed: Placed) -> tuple[Trace, Splats] | None:
    """As `_read`, of an object of which only colours and opacities have changed; the other arrays
    of its splats are shared with what they were.

    Args:
        before: What is remembered of the copy that `splats` were decoded from, with the filters
            that it has now.
        splats: As they were.
        placed: The object.

    Returns:
        None where more has changed, or others pass the filters.
    """
    rows = repainted_rows(before, placed.frozen)
    if rows is None:
        return None
    assert isinstance(placed.frozen, FrozenMesh)
    base, among = placed.frozen.base[rows], rows
    if placed.filters is not None:
        kept = placed.frozen.kept(placed.filters)
        if not np.array_equal(kept, before.kept):
            return None
        base, among = base[kept[rows]], (np.cumsum(kept) - 1)[rows[kept[rows]]]
    after = trace_of(placed.frozen, before.kept)
    return after, attributes.repainted(splats, among, base)


def _may_show(ob: bpy.types.Object) -> bool:
    return is_splats(ob) or is_native(ob)


def check_similar(placed: Placed) -> None:
    """Raise ValueError, which names the object, unless splats can follow its matrix; quick enough
    for every redraw."""
    if problem := _refusal(placed.matrix.tobytes()):
        raise ValueError(f"{placed.name} cannot be rendered. {problem}")


@lru_cache(maxsize=1024)
def _refusal(matrix: bytes) -> str:
    """Why splats cannot follow a [4, 4] float64; empty where they can."""
    try:
        transform_splats(attributes.NO_SPLATS, np.frombuffer(matrix).reshape(4, 4))
    except ValueError as error:
        return error_words(error)
    return ""


def _moved(splats: Splats, matrix: np.ndarray) -> Splats:
    matrix[3] = 0, 0, 0, 1  # an inversion leaves it so but for rounding
    return transform_splats(splats, matrix)


def _concatenated(parts: list[Splats]) -> Splats:
    """One model; SH of lower degrees are filled up with zeros, which changes nothing."""
    rest = max(p.shN.shape[1] for p in parts)
    padded = [np.pad(p.shN, ((0, 0), (0, rest - p.shN.shape[1]), (0, 0))) for p in parts]
    names = ("means", "quats", "scales", "opacities", "sh0")
    joined = {n: np.concatenate([getattr(p, n) for p in parts]) for n in names}
    return Splats(**joined, shN=np.concatenate(padded))
