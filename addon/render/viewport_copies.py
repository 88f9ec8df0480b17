"""Viewport copies of splats, made incrementally while earlier copies are drawn."""

import time
from dataclasses import dataclass

import bpy
import numpy as np

from .mesh_copies import Freezer, Frozen, FrozenMesh
from .scene import Placed, Source, place

COPY_BUDGET = 0.003
"""Seconds that one redraw may spend on copying splats out of Blender."""
EDITED_AT_ONCE = 200_000
"""Most splats in Edit Mode that are copied again after each edit; of larger meshes only selection
and visibility follow, and the rest when Edit Mode ends."""
_ECHO = 0.25
"""Seconds within which Blender reports the change that a copy itself causes: copying a mesh in
Edit Mode writes its edits back to the mesh. Grows if redraws take longer."""
_LONGEST_ECHO = 10.0
"""Upper limit of that time, seconds."""
_SAME_UPDATE = 0.005
"""Seconds within which all handlers receive one update."""
_REST = 0.5
"""Seconds after which a copy is made once more if an update was ignored as an echo, because an edit
may have come with it."""


@dataclass
class _Echo:
    """State of the last copy of a mesh in Edit Mode."""

    at: float
    """Time of the copy, seconds."""
    same: bool
    """Whether it equals the copy before, so that the next update reports only the copy."""
    checked: bool
    """Whether the copy was made to check that no edit was missed."""
    passed: float = 0.0
    """Time of the update that was ignored as its echo; 0: none."""
    late: float = 0.0
    """Delay of an update that was too late for an echo, seconds; 0: none."""


class Copies:
    """Copies for all viewports; main thread only."""

    def __init__(self) -> None:
        self._frozen: dict[int, FrozenMesh] = {}
        self._stale: dict[int, Frozen] = {}
        self._freezers: dict[int, Freezer] = {}
        self._unmarked: set[int] = set()
        """Meshes in Edit Mode whose selection may have changed."""
        self._echoes: dict[int, _Echo] = {}
        self._echo = _ECHO
        """Echo time measured on this machine, seconds."""

    def clear(self) -> None:
        """Drop all copies."""
        for kept in (self._frozen, self._stale, self._freezers, self._unmarked, self._echoes):
            kept.clear()

    def under_way(self, found: list[Source]) -> bool:
        """Whether meshes of objects are still being copied or wait for a last check, so that views
        must be redrawn. Frames being read request redraws themselves when they arrive."""
        doubtful = {uid for uid, echo in self._echoes.items() if echo.passed and not echo.checked}
        waits = doubtful | self._freezers.keys()
        return any(one.moment is None and one.uid in waits for one in found)

    def forget_changed(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Mark meshes that a depsgraph update reports as changed for a new copy."""
        for update in depsgraph.updates:
            uid = getattr(update.id.original, "session_uid", None)
            if isinstance(update.id, bpy.types.Object) and update.is_updated_geometry:
                data = update.id.original.data
                uid = None if data is None else data.session_uid
            elif not update.is_updated_geometry:
                # In Edit Mode a selection updates a mesh without a geometry change.
                if isinstance(update.id, bpy.types.Mesh) and update.id.original.is_editmode:
                    self._unmarked.add(uid)
                continue
            self._freezers.pop(uid, None)
            if uid in self._frozen and not self._is_echo(uid):
                self._stale[uid] = self._frozen.pop(uid)

    def _is_echo(self, uid: int) -> bool:
        """Whether an update reports only the last copy of a mesh in Edit Mode."""
        echo, now = self._echoes.get(uid), time.perf_counter()
        if echo is None or not echo.same:
            return False
        if now - echo.at > self._echo:
            echo.late = now - echo.at
            return False
        if echo.passed and now - echo.passed > _SAME_UPDATE:
            return False
        echo.passed = echo.passed or now
        return True

    def repaint(self, uid: int, base: np.ndarray) -> None:
        """Show a mesh with other colours and opacities until it is copied again.

        Args:
            uid: Session uid of the mesh.
            base: `radiance:base`, [N, 4] float32, contiguous; not copied.
        """
        for kept in (self._frozen, self._stale):
            if uid in kept and len(kept[uid].vertices) == len(base):
                kept[uid] = kept[uid].repainted(base)
        if uid in self._freezers:
            self._freezers[uid].repaint(base)

    def remark(self, uid: int, marks: np.ndarray | None) -> None:
        """Show another selection and visibility, [N] uint8 as `FrozenMesh.marks`."""
        for kept in (self._frozen, self._stale):
            if uid in kept and (marks is None or len(kept[uid].vertices) == len(marks)):
                kept[uid] = kept[uid].remarked(marks)

    def too_many(self, uid: int) -> bool:
        """Whether a mesh was copied before and is too large to be copied during edits."""
        known = self._frozen.get(uid, self._stale.get(uid))
        return known is not None and len(known.vertices) > EDITED_AT_ONCE

    def keep_only(self, found: list[Source]) -> None:
        """Drop copies of all other sources."""
        uids = {source.uid for source in found}
        for kept in (self._frozen, self._stale, self._freezers, self._echoes):
            for uid in kept.keys() - uids:
                del kept[uid]

    def copied(
        self, found: list[Source], *, always_filtered: bool = False, spare: float = 0.0
    ) -> tuple[list[Placed], bool]:
        """Copies of objects, and whether all are up to date.

        An object whose copy is in progress appears with its earlier copy, or not at all.

        Args:
            found: The objects.
            always_filtered: As `place`.
            spare: Seconds for copying in addition to `COPY_BUDGET`.
        """
        until = time.perf_counter() + COPY_BUDGET + spare
        placed, complete = [], True
        for source in found:
            frozen = self._copy(source, until) if source.moment is None else self._frame(source)
            complete &= frozen is not None
            frozen = frozen or self._stale.get(source.uid)
            if frozen is not None:
                placed.append(place(source, frozen, always_filtered=always_filtered))
        return placed, complete

    def _frame(self, source: Source) -> Frozen | None:
        """The current frame of an object; if it cannot be read, the last one, or its mesh."""
        frame = source.moment.ready()
        if frame is not None:
            self._stale[source.uid] = frame
            return frame
        if source.moment.waits():
            return None
        if source.uid not in self._stale:
            self._stale[source.uid] = source.frozen_mesh()
        return self._stale[source.uid]

    def _copy(self, source: Source, until: float) -> Frozen | None:
        uid = source.uid
        if source.is_edited:
            echo = self._echoes.get(uid)
            doubtful = echo is not None and echo.passed and not echo.checked
            doubtful = doubtful and time.perf_counter() - echo.at > _REST
            if uid in self._frozen and doubtful:
                self._stale[uid] = self._frozen.pop(uid)
            stale = self._stale.get(uid)
            if uid not in self._frozen:
                if stale is not None and len(stale.vertices) > EDITED_AT_ONCE:
                    return stale
                self._frozen[uid] = made = source.frozen_mesh()
                same = stale is not None and stale.fingerprint == made.fingerprint
                if same and np.array_equal(stale.marks, made.marks):
                    self._frozen[uid] = stale  # so that views have nothing to update
                if same and echo is not None and echo.late:
                    self._echo = min(max(self._echo, 2 * echo.late), _LONGEST_ECHO)
                at = time.perf_counter()
                self._echoes[uid] = _Echo(at=at, same=same, checked=same and doubtful)
        else:
            self._echoes.pop(uid, None)
        known = self._frozen.get(uid)
        if uid in self._unmarked and known and len(known.vertices) <= EDITED_AT_ONCE:
            self._frozen[uid] = known.remarked(source.marks())
        self._unmarked.discard(uid)
        while uid not in self._frozen:
            freezer = self._freezers.pop(uid, None) or Freezer()
            frozen = freezer.step(source.data, source.ob.name)  # may raise for a bad mesh
            if frozen is None:
                self._freezers[uid] = freezer
                if freezer.waits or time.perf_counter() > until:
                    return None
            else:
                self._frozen[uid] = frozen
                self._stale.pop(uid, None)
        return self._frozen[uid]


SHARED = Copies()
"""The copies of this Blender session."""
