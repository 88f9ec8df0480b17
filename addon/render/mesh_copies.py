"""Mesh copies: splat attributes copied out of Blender, to be decoded in a thread without bpy."""

import sys
import zlib
from collections.abc import Hashable, Sized
from typing import Any, Protocol

import numpy as np

from .. import attributes
from ..attributes import BASE, POSITION, ROTATION, SCALE, SH
from ..core import Splats
from ..process.reserved_memory import Memory
from ..splats.filters import Filters, mask

_KEYS = {"FLOAT_VECTOR": ("vector", 3), "QUATERNION": ("value", 4), "FLOAT4": ("vector", 4)}
_KEYS["FLOAT_COLOR"] = ("color", 4)
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


class _Data:
    """Interface of `attribute.data`."""

    def __init__(self, values: np.ndarray, width: int) -> None:
        self.values, self.width = values, width

    def __len__(self) -> int:
        return len(self.values) // self.width

    def foreach_get(self, key: str, out: np.ndarray) -> None:
        """Copy everything to `out`."""
        out[:] = self.values


class _Attribute:
    """Interface of an attribute, over its own memory."""

    def __init__(self, name: str, domain: str, data_type: str, values: np.ndarray) -> None:
        self.name, self.domain, self.data_type = name, domain, data_type
        self.data = _Data(values, _KEYS.get(data_type, ("", 1))[1])
        self.fingerprint = (name, domain, data_type, zlib.crc32(values))

    def refilled(self, values: np.ndarray) -> "_Attribute":
        """A copy of the attribute with other values, flat float32."""
        return _Attribute(self.name, self.domain, self.data_type, values)


def _numbers(attribute: Any) -> int:
    """Number of floats to copy of Blender's attribute; 0 for types that splats do not have, which
    the reader refuses."""
    _, width = _KEYS.get(attribute.data_type, ("", 0))
    return len(attribute.data) * width


def _copied(attribute: Any, memory: Memory | None) -> _Attribute:
    """A copy of Blender's attribute, in the next array of `memory` if given."""
    values = memory.take() if memory else np.empty(_numbers(attribute), np.float32)
    if len(values):
        attribute.data.foreach_get(_KEYS[attribute.data_type][0], values)
    return _Attribute(attribute.name, attribute.domain, attribute.data_type, values)


class _Attributes(dict[str, _Attribute]):
    """Attributes by name; like Blender's, iteration yields attributes."""

    def __iter__(self) -> Any:
        return iter(self.values())


class FrozenMesh:
    """Copied splat attributes of a mesh or point cloud, with the interface of the datablock."""

    def __init__(self, name: str, count: int) -> None:
        self.name = name
        self.vertices = range(count)
        self.attributes = _Attributes()
        self.marks: np.ndarray | None = None
        """[N] uint8 of SELECTED and HIDDEN; None: no marks. Not in the fingerprint, because the
        splats stay the same."""

    @classmethod
    def of(cls, name: str, columns: dict[str, np.ndarray]) -> "FrozenMesh":
        """The splats of given attributes, which are not copied; without marks.

        Args:
            name: Object name for messages.
            columns: As for `attributes.as_splats`.
        """
        made = cls(name, len(columns[BASE]))
        for one in sorted(columns):  # as `Freezer` does, so that the fingerprint is the same
            kind = attributes.kind_of(one)
            dict.__setitem__(
                made.attributes, one, _Attribute(one, "POINT", kind, columns[one].reshape(-1))
            )
        return made

    @property
    def fingerprint(self) -> tuple[Any, ...]:
        """Differs if any value differs, except for one case in 2^32 per attribute (CRC)."""
        return (len(self.vertices), *(a.fingerprint for a in self.attributes.values()))

    def remarked(self, marks: np.ndarray | None) -> "FrozenMesh":
        """The same splats with other marks."""
        made = FrozenMesh(self.name, len(self.vertices))
        made.attributes, made.marks = self.attributes, marks
        return made

    def can_take(self, base: np.ndarray) -> bool:
        """Whether `base` fits `repainted`."""
        return BASE in self.attributes and len(base) == len(self.vertices)

    def repainted(self, base: np.ndarray) -> "FrozenMesh":
        """The same splats with other colours and opacities.

        Args:
            base: `radiance:base`, [N, 4] float32, contiguous; not copied.
        """
        made = FrozenMesh(self.name, len(self.vertices))
        made.attributes.update((a.name, a) for a in self.attributes)
        made.attributes[BASE] = self.attributes[BASE].refilled(base.reshape(-1))
        made.marks = self.marks
        return made

    @property
    def unpainted(self) -> tuple[Any, ...] | None:
        """Like `fingerprint`, but without the values of `radiance:base`; None: there is no such
        attribute."""
        if BASE not in self.attributes:
            return None
        found = (a.fingerprint[: 3 if a.name == BASE else 4] for a in self.attributes)
        return (len(self.vertices), *sorted(found))

    @property
    def base(self) -> np.ndarray:
        """[N, 4] float32 view of `radiance:base`."""
        return self.attributes[BASE].data.values.reshape(-1, 4)

    def read(self) -> Splats:
        """The splats; errors as `attributes.read`."""
        return attributes.read(self)

    def kept(self, filters: Filters) -> np.ndarray:
        """Splats that pass the filters, [N] bool."""
        means, scales, base = (attributes.column(self, name) for name in (POSITION, SCALE, BASE))
        return mask(means, scales, base[:, 3], filters)


class Freezer:
    """Copies a datablock's splat attributes one per step, so that the main thread stays free."""

    def __init__(self, *, ahead: int = AHEAD) -> None:
        """Prepare; copies nothing yet.

        Args:
            ahead: Floats of all attributes from which on a thread allocates their memory.
        """
        self._ahead = ahead
        self._begun: FrozenMesh | None = None
        self._memory: Memory | None = None

    @property
    def waits(self) -> bool:
        """Whether memory for the next step is not ready, so that the step does nothing."""
        return self._memory is not None and not self._memory.ready

    def step(self, data: Any, name: str) -> FrozenMesh | None:
        """Copy one more attribute, unless it `waits`; return the copy when it is complete.

        Args:
            data: Mesh or point cloud; it must not change between the steps of one copy.
            name: Object name for messages.
        """
        if self._begun is None:
            self._begin(data, name)
        frozen = self._begun
        missing = sorted(set(_wanted(data)) - frozen.attributes.keys())
        if missing:
            if not self.waits:
                copy = _copied(data.attributes[missing[0]], self._memory)
                dict.__setitem__(frozen.attributes, missing[0], copy)
                if len(missing) == 1:
                    self._memory = None  # all arrays are in use
            return None
        self._begun = None
        frozen.marks = read_marks(data)
        return frozen

    def _begin(self, data: Any, name: str) -> None:
        points = data.vertices if hasattr(data, "vertices") else data.points
        self._begun = FrozenMesh(name, len(points))
        sizes = [_numbers(data.attributes[n]) for n in sorted(_wanted(data))]
        self._memory = Memory(sizes) if sum(sizes) >= self._ahead else None

    def repaint(self, base: np.ndarray) -> None:
        """Replace colours and opacities in an unfinished copy; as `FrozenMesh.repainted`.

        Does nothing if they are not copied yet; their step then copies those of the datablock.
        """
        if self._begun is not None and self._begun.can_take(base):
            self._begun = self._begun.repainted(base)


def freeze(data: Any, name: str) -> FrozenMesh:
    """Copy all splat attributes of a datablock in one call; arguments as `Freezer.step`."""
    freezer = Freezer(ahead=sys.maxsize)
    while (frozen := freezer.step(data, name)) is None:
        pass
    return frozen


def _wanted(data: Any) -> list[str]:
    names = [a.name for a in data.attributes]
    return [n for n in names if n in (POSITION, SCALE, ROTATION, BASE) or n.startswith(SH)]


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
