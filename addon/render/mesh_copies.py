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
"""Bits of marks: what the user has done to a point in Edit Mode."""
AHEAD = 1 << 21
"""Numbers, 8 MB, whose memory takes the main thread too long to get."""
_MARKED_BY = {".select_vert": SELECTED, ".hide_vert": HIDDEN}


class Frozen(Protocol):
    """Splats that are no longer Blender's, of a mesh or of a file."""

    @property
    def vertices(self) -> Sized:
        """One a splat."""

    @property
    def fingerprint(self) -> Hashable:
        """Differs wherever a value does."""

    @property
    def marks(self) -> np.ndarray | None:
        """[N] uint8 of SELECTED and HIDDEN; None: none has any."""

    def read(self) -> Splats:
        """The splats; ValueError where some are missing or not finite."""

    def kept(self, filters: Filters) -> np.ndarray:
        """[N] bool: which of them filters let pass."""


class _Data:
    """What `attribute.data` offers."""

    def __init__(self, values: np.ndarray, width: int) -> None:
        self.values, self.width = values, width

    def __len__(self) -> int:
        return len(self.values) // self.width

    def foreach_get(self, key: str, out: np.ndarray) -> None:
        """Copy everything to `out`."""
        out[:] = self.values


class _Attribute:
    """What an attribute offers; its memory is its own."""

    def __init__(self, name: str, domain: str, data_type: str, values: np.ndarray) -> None:
        self.name, self.domain, self.data_type = name, domain, data_type
        self.data = _Data(values, _KEYS.get(data_type, ("", 1))[1])
        self.fingerprint = (name, domain, data_type, zlib.crc32(values))

    def refilled(self, values: np.ndarray) -> "_Attribute":
        """The same attribute with other values, flat float32."""
        return _Attribute(self.name, self.domain, self.data_type, values)


def _numbers(attribute: Any) -> int:
    """How many numbers are copied of Blender's attribute; none where its type is none of a splat's,
    which the reader refuses."""
    _, width = _KEYS.get(attribute.data_type, ("", 0))
    return len(attribute.data) * width


def _copied(attribute: Any, memory: Memory | None) -> _Attribute:
    """A copy of Blender's attribute, where there is a memory in its next array."""
    values = memory.take() if memory else np.empty(_numbers(attribute), np.float32)
    if len(values):
        attribute.data.foreach_get(_KEYS[attribute.data_type][0], values)
    return _Attribute(attribute.name, attribute.domain, attribute.data_type, values)


class _Attributes(dict[str, _Attribute]):
    """Indexed by name and, like Blender's, giving attributes when iterated over."""

    def __iter__(self) -> Any:
        return iter(self.values())


class FrozenMesh:
    """The splat attributes of a mesh or point cloud as they were; reads like the datablock."""

    def __init__(self, name: str, count: int) -> None:
        self.name = name
        self.vertices = range(count)
        self.attributes = _Attributes()
        self.marks: np.ndarray | None = None
        """[N] uint8 of SELECTED and HIDDEN; None: no point has any. Not in the fingerprint, because
        splats stay what they are."""

    @classmethod
    def of(cls, name: str, columns: dict[str, np.ndarray]) -> "FrozenMesh":
        """The splats of copies of attributes, which belong to it from now on; without marks.

        Args:
            name: What messages shall call them.
            columns: As `attributes.as_splats` takes them.
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
        """Differs wherever a value does, but for one case in 2^32 an attribute."""
        return (len(self.vertices), *(a.fingerprint for a in self.attributes.values()))

    def remarked(self, marks: np.ndarray | None) -> "FrozenMesh":
        """The same splats with other marks."""
        made = FrozenMesh(self.name, len(self.vertices))
        made.attributes, made.marks = self.attributes, marks
        return made

    def can_take(self, base: np.ndarray) -> bool:
        """Whether `repainted` can be given this."""
        return BASE in self.attributes and len(base) == len(self.vertices)

    def repainted(self, base: np.ndarray) -> "FrozenMesh":
        """The same splats with other colours and opacities.

        Args:
            base: [N, 4] float32, contiguous, of `radiance:base`; from now on it belongs to this.
        """
        made = FrozenMesh(self.name, len(self.vertices))
        made.attributes.update((a.name, a) for a in self.attributes)
        made.attributes[BASE] = self.attributes[BASE].refilled(base.reshape(-1))
        made.marks = self.marks
        return made

    @property
    def unpainted(self) -> tuple[Any, ...] | None:
        """Like `fingerprint`, but the same whatever the values of `radiance:base`; None: there is
        no such attribute."""
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
        """[N] bool: which of them filters let pass."""
        means, scales, base = (attributes.column(self, name) for name in (POSITION, SCALE, BASE))
        return mask(means, scales, base[:, 3], filters)


class Freezer:
    """Copies a datablock's splat attributes one at a time, so that nobody waits for all."""

    def __init__(self, *, ahead: int = AHEAD) -> None:
        """Nothing is copied yet.

        Args:
            ahead: From so many numbers of all attributes on a thread makes the memory for them.
        """
        self._ahead = ahead
        self._begun: FrozenMesh | None = None
        self._memory: Memory | None = None

    @property
    def waits(self) -> bool:
        """Whether the next step has to wait for memory, and so does nothing."""
        return self._memory is not None and not self._memory.ready

    def step(self, data: Any, name: str) -> FrozenMesh | None:
        """Copy one more attribute, unless it `waits`; the whole once there are no more.

        Args:
            data: Mesh or point cloud; between the steps of one copy it must not change.
            name: What messages shall call it: the object's name.
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
                    self._memory = None  # nothing is left to wait for
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
        """Have the copy that has begun get other colours and opacities; as `FrozenMesh.repainted`.

        It does where it has copied those of the datablock; else they are copied in their turn.
        """
        if self._begun is not None and self._begun.can_take(base):
            self._begun = self._begun.repainted(base)


def freeze(data: Any, name: str) -> FrozenMesh:
    """All of a datablock's splat attributes at once; arguments as `Freezer.step`."""
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
