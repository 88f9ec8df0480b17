"""Mesh copies: splat attributes copied out of Blender, to be decoded in a thread without bpy, and
marks of selected and hidden splats.
"""

import sys
import zlib
from collections.abc import Hashable, Sized
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np

from .. import attributes
from ..attributes import BASE, POSITION, SCALE
from ..core import Splats, sh_basis
from ..process.incremental_tasks import Steps, TaskRunner, run_in_thread
from ..splats.filters import Filters, mask
from ..splats.point_attributes import Column, copy_values, empty_values, zeroed

SELECTED, HIDDEN = 1, 2
"""Bits of marks: selection and visibility of a point in Edit Mode."""
AHEAD = 1 << 21
"""Floats, 8 MB, from which on allocating takes too long on the main thread."""
_MARKED_BY = {".select_vert": SELECTED, ".hide_vert": HIDDEN}


class Frozen(Protocol):
    """Copied splats of a mesh or a file, independent of Blender's data."""

    @property
    def vertices(self) -> Sized:
        """One item per splat."""

    @property
    def fingerprint(self) -> Hashable:
        """Differs if any value differs."""

    @property
    def marks(self) -> np.ndarray | None:
        """[N] uint8 of SELECTED and HIDDEN; None: no marks."""

    def read(self) -> Splats:
        """The splats; ValueError if attributes are missing or not finite."""

    def kept(self, filters: Filters) -> np.ndarray:
        """Splats that pass the filters, [N] bool."""


@dataclass(frozen=True, eq=False)
class FrozenMesh:
    """Copied splat attributes of a mesh or point cloud."""

    name: str
    """Object name for messages."""
    columns: dict[str, np.ndarray]
    """[N, 3] or [N, 4] float32 by `attributes.names`, not to be changed."""
    sums: dict[str, int]
    """CRC of each."""
    marks: np.ndarray | None = None
    """[N] uint8 of SELECTED and HIDDEN; None: no marks. Not in the fingerprint, because the splats
    stay the same."""

    @classmethod
    def of(cls, name: str, columns: dict[str, np.ndarray]) -> "FrozenMesh":
        """The splats of given attributes, which are not copied; without marks."""
        return cls(name, columns, {one: zlib.crc32(columns[one]) for one in columns})

    @property
    def vertices(self) -> range:
        """One item per splat."""
        return range(len(self.base))

    @property
    def fingerprint(self) -> tuple[Any, ...]:
        """Differs if any value differs, except for one case in 2^32 per attribute (CRC)."""
        return (len(self.vertices), *sorted(self.sums.items()))

    @property
    def unpainted(self) -> tuple[Any, ...]:
        """Like `fingerprint`, but without the values of `radiance:base`."""
        return (len(self.vertices), *sorted(i for i in self.sums.items() if i[0] != BASE))

    @property
    def base(self) -> np.ndarray:
        """[N, 4] float32, `radiance:base`."""
        return self.columns[BASE]

    def remarked(self, marks: np.ndarray | None) -> "FrozenMesh":
        """The same splats with other marks."""
        return replace(self, marks=marks)

    def repainted(self, base: np.ndarray) -> "FrozenMesh":
        """The same splats with other colours and opacities.

        Args:
            base: `radiance:base`, [N, 4] float32, contiguous; not copied.
        """
        sums = {**self.sums, BASE: zlib.crc32(base)}
        return replace(self, columns={**self.columns, BASE: base}, sums=sums)

    def read(self) -> Splats:
        """The splats; ValueError if values are not finite."""
        for one, values in self.columns.items():
            attributes.check_finite(values, one, self.name)
        own = {one: v.copy() for one, v in self.columns.items() if attributes.is_splats(one)}
        return attributes.as_splats(own)

    @property
    def can_be_relit(self) -> bool:
        """Whether there are `attributes.NORMAL` and `CAPTURED`."""
        return attributes.NORMAL in self.columns

    def kept(self, filters: Filters) -> np.ndarray:
        """Splats that pass the filters, [N] bool."""
        means = self.columns.get(POSITION, attributes.NO_SPLATS.means)
        return mask(means, self.columns[SCALE], self.base[:, 3], filters)


class Freezer:
    """Copies a datablock's splat attributes one per step, so that the main thread stays free."""

    def __init__(self, *, ahead: int = AHEAD) -> None:
        """Prepare; copies nothing yet.

        Args:
            ahead: Floats of all attributes from which on a thread allocates their memory.
        """
        self._ahead = ahead
        self._copy = FrozenMesh("", {}, {})
        self._data: Any = None
        self._runner = TaskRunner(self._copying())

    @property
    def waits(self) -> bool:
        """Whether memory is not ready, so that the next step does nothing."""
        return self._runner.waits

    def step(self, data: Any, name: str) -> FrozenMesh | None:
        """Copy one more attribute, unless it `waits`; return the copy when it is complete.

        Args:
            data: Mesh or point cloud; it must not change between the steps of one copy.
            name: Object name for messages.

        Raises:
            ValueError: attributes are missing.
        """
        self._data, self._copy = data, replace(self._copy, name=name)
        return self._copy.remarked(read_marks(data)) if self._runner.step() else None

    def _copying(self) -> Steps[None]:
        data, name = self._data, self._copy.name
        found = [*attributes.names(data, called=name), *attributes.light_names(data)]
        kinds = {one: attributes.check_vectors(data, one, called=name).data_type for one in found}
        count = attributes.point_count(data)
        if count * sum(attributes.FORMATS[kind][1] for kind in kinds.values()) < self._ahead:
            columns = [Column(one, kind, empty_values(kind, count)) for one, kind in kinds.items()]
        else:
            columns = yield from run_in_thread(partial(zeroed, kinds, count), "")
        for one, _, values in columns:
            copy_values(self._data, one, values)
            self._copy.columns[one], self._copy.sums[one] = values, zlib.crc32(values)
            yield ""

    def repaint(self, base: np.ndarray) -> None:
        """Replace colours and opacities in an unfinished copy; as `FrozenMesh.repainted`.

        Does nothing if they are not copied yet; their step then copies those of the datablock.
        """
        if len(self._copy.columns.get(BASE, ())) == len(base):
            self._copy = self._copy.repainted(base)


def freeze(data: Any, name: str) -> FrozenMesh:
    """Copy all splat attributes of a datablock in one call; arguments as `Freezer.step`."""
    freezer = Freezer(ahead=sys.maxsize)
    while (frozen := freezer.step(data, name)) is None:
        pass
    return frozen


class Trace(NamedTuple):
    """Digest of a decoded copy, in a fraction of its memory: data that show whether another copy
    differs and, if only in paint, in which splats."""

    fingerprint: Hashable
    """`Frozen.fingerprint`."""
    unpainted: Hashable
    """`FrozenMesh.unpainted`; None: the splats come from a file and cannot be painted."""
    base: np.ndarray | None
    """`radiance:base`, [N, 4]; None: the splats come from a file."""
    kept: np.ndarray | None
    """[N] bool, splats that passed the filters; None: no filters."""


def trace_of(frozen: Frozen, kept: np.ndarray | None = None) -> Trace:
    """The trace of a copy whose `kept` splats were decoded."""
    if isinstance(frozen, FrozenMesh):
        return Trace(frozen.fingerprint, frozen.unpainted, frozen.base, kept)
    return Trace(frozen.fingerprint, None, None, kept)


def repainted_rows(before: Trace, after: Frozen) -> np.ndarray | None:
    """Indices [K] of splats that differ in colour or opacity only.

    None if the copies differ otherwise, or if new values are not finite, which decoding refuses.
    """
    if before.base is None or not isinstance(after, FrozenMesh):
        return None
    if before.unpainted != after.unpainted:
        return None
    rows = np.flatnonzero((before.base != after.base).any(axis=1))
    return rows if np.isfinite(after.base[rows]).all() else None


def read_marks(data: Any) -> np.ndarray | None:
    """`FrozenMesh.marks` of a mesh that is not in Edit Mode; a point cloud has none."""
    count = len(data.vertices) if hasattr(data, "vertices") else 0
    marks, flags = np.zeros(count, np.uint8), np.empty(count, bool)
    for name, bit in _MARKED_BY.items():
        attribute = data.attributes.get(name)
        if attribute is not None and attribute.domain == "POINT" and len(attribute.data) == count:
            attribute.data.foreach_get("value", flags)
            marks |= flags.astype(np.uint8) * np.uint8(bit)
    return marks if marks.any() else None


TINT = np.float32([1.0, 0.5, 0.05])
"""sRGB values, close to selected vertices in Blender's own themes."""
SHARE = np.float32(0.65)
"""Share of the tint in the colour of a selected splat; the rest keeps splats distinguishable."""


def tinted(colors: np.ndarray, marks: np.ndarray) -> np.ndarray:
    """Colours [B, 3] float32 of splats, tinted where their marks [B] are selected."""
    chosen = (marks & SELECTED) != 0
    return np.where(chosen[:, None], colors + SHARE * (TINT - colors), colors)


def reselected(
    before: np.ndarray | None, after: np.ndarray | None, count: int
) -> np.ndarray | None:
    """Splats that were selected or deselected between two sets of marks ([count] or None), [count]
    bool; None if visibility has changed."""
    none = np.zeros(count, np.uint8)
    differ = (none if before is None else before) ^ (none if after is None else after)
    return None if (differ & HIDDEN).any() else differ != 0


def shown(marks: np.ndarray) -> np.ndarray:
    """Splats that are not hidden by their marks [B], [B] bool."""
    return (marks & HIDDEN) == 0


def tinted_splats(splats: Splats, marks: np.ndarray) -> Splats:
    """Splats for a picture with marks [N]: without hidden splats, selected splats tinted."""
    there = shown(marks)
    if not there.all():
        splats, marks = splats.subset(there), marks[there]
    chosen = (marks & SELECTED) != 0
    if not chosen.any():
        return splats
    constant = sh_basis(0, np.zeros((1, 3), np.float32))[0, 0]
    sh0, shN = splats.sh0.copy(), splats.shN.copy()
    sh0[chosen] += SHARE * ((TINT - np.float32(0.5)) / constant - sh0[chosen])
    shN[chosen] *= 1 - SHARE
    return replace(splats, sh0=sh0, shN=shN)
