"""Splats <-> point attributes named like Blender's own Gaussian splats; works on any datablock.

| attribute | type | meaning |
|---|---|---|
| `position` | FLOAT_VECTOR | means |
| `scale` | FLOAT_VECTOR | standard deviations, linear |
| `rotation` | QUATERNION | wxyz, unit length |
| `radiance:base` | FLOAT_COLOR | constant SH coefficient r, g, b and the opacity in [0, 1] |
| `radiance:sh_<k>` | FLOAT_VECTOR | SH coefficient k + 1, rgb; k = 0..14 at degree 3, 0..23 at 4 |

All float32. `exp` and the sigmoid are evaluated in float64, so that the way back is exact to the
last bits of float32, with one limit: near 1 an opacity is spaced by 6e-8, so logits above 5 come
back with an error growing to 1e-3 at logit 10, and those above 16.6 as 16.6 (an opacity of
1 - 2^-24). The error is invisible, because no splat is drawn with more than 0.99.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from .core import Splats, count_text

POSITION, SCALE, ROTATION = "position", "scale", "rotation"
BASE, SH = "radiance:base", "radiance:sh_"
NORMAL, CAPTURED = "gs_normal", "gs_captured"
"""Attributes of splats that can be relit: unit normal, and linear light of a white surface in the
photos, see `render.relight`."""
HEALED = "gs_healed"
"""Attribute of splats that were added by Heal or Clone: true."""
SH_COUNTS = (0, 3, 8, 15, 24)
"""Numbers of `radiance:sh_<k>` attributes of SH degrees 0 to 4."""
NO_SPLATS = Splats(
    means=np.zeros((0, 3), np.float32),
    quats=np.zeros((0, 4), np.float32),
    scales=np.zeros((0, 3), np.float32),
    opacities=np.zeros(0, np.float32),
    sh0=np.zeros((0, 1, 3), np.float32),
    shN=np.zeros((0, 0, 3), np.float32),
)

_KINDS = {
    "FLOAT_VECTOR": ("vector", 3),
    "QUATERNION": ("value", 4),
    "FLOAT_COLOR": ("color", 4),
    "FLOAT4": ("vector", 4),
}
"""Key for foreach_get and width in floats, by data type."""
FORMATS = {
    **_KINDS,
    "FLOAT": ("value", 1),
    "INT": ("value", 1),
    "BOOLEAN": ("value", 1),
    "FLOAT2": ("vector", 2),
    "FLOAT4X4": ("value", 16),
    "BYTE_COLOR": ("color_srgb", 4),
    "INT8": ("value", 1),
    "INT16_2D": ("value", 2),
    "INT32_2D": ("value", 2),
}
"""Key and width like `_KINDS`, of all attributes that survive deleting and joining points."""
_BLOCK = 1 << 12
"""Splats rearranged per block."""
SELECTION = ".select_vert"
_POINT_SELECTION = ".selection"
_TINY = float(np.finfo(np.float32).tiny)
_LARGEST_OPACITY = 1.0 - 2.0**-24
"""The float32 below 1."""
_SMALLEST_SCALE = np.float32(np.log(_TINY))
"""Log scale of a splat without extent."""


def typical_size(splats: Splats) -> float:
    """Median of the largest standard deviations; 0 without splats."""
    return float(np.exp(np.median(splats.scales.max(axis=1)))) if len(splats) else 0.0


def write(datablock: Any, splats: Splats) -> None:
    """Write the attributes of N splats to a mesh or point cloud with exactly N points.

    Args:
        datablock: Mesh or PointCloud with `attributes`.
        splats: Raw parameters.
    """
    made = columns(splats)
    # Declare all first, because adding an attribute moves the others' memory.
    for name, kind, _ in made:
        declare(datablock, name, kind)
    for name, kind, values in made:
        fill(datablock, name, kind, values)


def columns(splats: Splats) -> list[tuple[str, str, np.ndarray]]:
    """Name, data type and values of all attributes of N splats; touches no datablock.

    Values are flat float32, which `foreach_set` copies without conversion.
    """
    logits = np.clip(splats.opacities.astype(np.float64), -500, 500)  # exp stays finite
    opacities = 1.0 / (1.0 + np.exp(-logits))
    base = np.empty((len(splats), 4), np.float32)
    base[:, :3] = splats.sh0[:, 0]
    base[:, 3] = opacities
    lengths = np.linalg.norm(splats.quats.astype(np.float64), axis=1, keepdims=True)
    made = [
        (POSITION, "FLOAT_VECTOR", splats.means),
        (SCALE, "FLOAT_VECTOR", np.exp(splats.scales.astype(np.float64))),
        (ROTATION, "QUATERNION", splats.quats / lengths),
        (BASE, "FLOAT_COLOR", base),
    ]
    rest = _by_coefficient(splats.shN)
    made += [(f"{SH}{k}", "FLOAT_VECTOR", rows) for k, rows in enumerate(rest)]
    return [
        (name, kind, np.ascontiguousarray(values, np.float32).ravel())
        for name, kind, values in made
    ]


def declare(datablock: Any, name: str, kind: str) -> None:
    """Create a point attribute; replaces one of this name with another type or domain."""
    old = datablock.attributes.get(name)
    if old is not None and (old.data_type, old.domain) != (kind, "POINT"):
        datablock.attributes.remove(old)
        old = None
    if old is None:
        datablock.attributes.new(name, kind, "POINT")


def fill(datablock: Any, name: str, kind: str, values: np.ndarray) -> None:
    """Set a declared attribute from a flat contiguous array of its type."""
    datablock.attributes[name].data.foreach_set(FORMATS[kind][0], values)


def column(datablock: Any, name: str, *, called: str = "") -> np.ndarray:
    """[N, 3] or [N, 4] float32 copy of one attribute.

    Args:
        datablock: Mesh or PointCloud with `attributes`.
        name: Attribute name.
        called: Name of the datablock in messages; empty: its own.

    Raises:
        ValueError: the attribute is missing, is not a point attribute of a known type, or has
            non-finite values.
    """
    attribute = check_vectors(datablock, name, called=called)
    key, width = _KINDS[attribute.data_type]
    values = np.empty(len(attribute.data) * width, np.float32)
    attribute.data.foreach_get(key, values)
    values = values.reshape(-1, width)
    check_finite(values, name, called or datablock.name)
    return values


def check_finite(values: np.ndarray, name: str, called: str) -> None:
    """Raise ValueError unless all values [N, K] of an attribute are finite.

    Args:
        values: Attribute values.
        name: Attribute name.
        called: Name of the splats in messages.
    """
    if not np.isfinite(values).all():
        bad = ~np.isfinite(values).all(axis=1)
        raise ValueError(
            f"{called} has {count_text(int(bad.sum()), 'splat')} whose {name} is not finite, "
            f"the first is number {int(bad.argmax())}: delete them in Edit Mode."
        )


def check_vectors(datablock: Any, name: str, *, called: str = "") -> Any:
    """The attribute; ValueError unless it is a point attribute of vectors; `called` as `column`."""
    attribute = datablock.attributes.get(name)
    wanted = attribute is not None and attribute.domain == "POINT"
    if not wanted or attribute.data_type not in _KINDS:
        raise ValueError(
            f"{called or datablock.name} has no point attribute {name!r} of vectors: it is no "
            f"splat object, or the attribute was deleted or converted; undo that or import the "
            f"splats again."
        )
    return attribute


def copy_active(mesh: Any, old: Any) -> None:
    """Copy the active and the rendered color attribute from another mesh."""
    ours, theirs = mesh.attributes, old.attributes
    if theirs.active is not None and theirs.active.name in ours:
        ours.active = ours[theirs.active.name]
    for which in ("active_color_name", "default_color_name"):
        if getattr(theirs, which) in ours:
            setattr(ours, which, getattr(theirs, which))


def point_count(datablock: Any) -> int:
    """Number of vertices of a mesh, or points of a point cloud."""
    return len(datablock.vertices if hasattr(datablock, "vertices") else datablock.points)


def sh_count(datablock: Any, *, called: str = "") -> int:
    """Number of `radiance:sh_<k>` attributes; `called` as `column`.

    Raises:
        ValueError: some are missing.
    """
    have = {a.name for a in datablock.attributes if a.name.startswith(SH)}
    if not have:
        return 0
    numbers = [int(n.removeprefix(SH)) for n in have if n.removeprefix(SH).isdecimal()]
    # Degrees above 4 are unsupported.
    top = min(max(numbers, default=-1) + 1, SH_COUNTS[-1])
    count = next(c for c in SH_COUNTS if c >= top)
    missing = [f"{SH}{k}" for k in range(count) if f"{SH}{k}" not in have]
    if missing:
        raise ValueError(
            f"{called or datablock.name} lacks the attributes {', '.join(missing)} of its SH "
            f"degree: undo their deletion, or delete all {SH}<k> to go on without view-dependent "
            f"color."
        )
    return count


def read(datablock: Any, *, rest: bool = True) -> Splats:
    """Splats of a mesh or point cloud, raw parameters in the datablock's space.

    A vertex added by hand has a scale of zero. Such a splat gets the smallest scale and opacity
    of float32, which makes it invisible.

    Args:
        datablock: Mesh or PointCloud with `attributes`.
        rest: Also read shN, which is most of the data.

    Raises:
        ValueError: attributes are missing (the message names them) or have non-finite values.
    """
    return as_splats({name: column(datablock, name) for name in names(datablock, rest=rest)})


def names(datablock: Any, *, rest: bool = True, called: str = "") -> list[str]:
    """Names of the splat attributes of a mesh or point cloud, for `as_splats`.

    Args:
        datablock: Mesh or PointCloud with `attributes`.
        rest: Include shN.
        called: As `column`.

    Raises:
        ValueError: attributes are missing; the message names them.
    """
    check(datablock, called=called)
    found = [BASE, SCALE, ROTATION]
    if point_count(datablock):  # else Blender drops `position`
        found.append(POSITION)
    return found + [f"{SH}{k}" for k in range(sh_count(datablock, called=called) if rest else 0)]


def light_names(datablock: Any) -> list[str]:
    """`NORMAL` and `CAPTURED` if a mesh or point cloud has both."""
    found = [datablock.attributes.get(name) for name in (NORMAL, CAPTURED)]
    fit = all(a is not None and (a.data_type, a.domain) == ("FLOAT_VECTOR", "POINT") for a in found)
    return [NORMAL, CAPTURED] if fit else []


def as_splats(columns: dict[str, np.ndarray]) -> Splats:
    """Raw parameters from copies of attributes; touches no datablock.

    Args:
        columns: [N, 3] or [N, 4] by `names`; emptied, to save memory.
    """
    base, scales, quats = (columns.pop(name) for name in (BASE, SCALE, ROTATION))
    quats[~quats.any(axis=1)] = (1, 0, 0, 0)
    means = columns.pop(POSITION, np.zeros((0, 3), np.float32))
    coefficients = [columns.pop(f"{SH}{k}") for k in range(len(columns))]
    return Splats(
        means=means,
        quats=quats,
        scales=np.log(np.maximum(np.abs(scales).astype(np.float64), _TINY)).astype(np.float32),
        opacities=_logits(base[:, 3], ~scales.any(axis=1)),
        sh0=np.ascontiguousarray(base[:, None, :3]),
        shN=_by_splat(coefficients, len(base)),
    )


def repainted(splats: Splats, rows: np.ndarray, base: np.ndarray) -> Splats:
    """The same splats with new sh0 and opacities in some rows.

    Args:
        splats: From `as_splats`; all other parameters are shared.
        rows: [K] indices.
        base: [K, 4] of `radiance:base`, finite.
    """
    sh0, opacities = splats.sh0.copy(), splats.opacities.copy()
    invisible = (splats.scales[rows] <= _SMALLEST_SCALE).all(axis=1)
    sh0[rows, 0], opacities[rows] = base[:, :3], _logits(base[:, 3], invisible)
    return replace(splats, sh0=sh0, opacities=opacities)


def _logits(opacities: np.ndarray, invisible: np.ndarray) -> np.ndarray:
    """[K] float32 of opacities [K]; the smallest where a splat has no extent."""
    alpha = np.clip(opacities.astype(np.float64), _TINY, _LARGEST_OPACITY)
    alpha[invisible] = _TINY
    return (np.log(alpha) - np.log1p(-alpha)).astype(np.float32)


def check(datablock: Any, *, called: str = "") -> None:
    """Raise ValueError with the missing attributes unless all exist; `called` as `column`."""
    missing = [n for n in (POSITION, SCALE, ROTATION, BASE) if n not in datablock.attributes]
    # Blender drops `position` from a mesh without vertices.
    if missing and not (missing == [POSITION] and point_count(datablock) == 0):
        raise ValueError(
            f"{called or datablock.name} contains no splats: the attributes {', '.join(missing)} "
            f"are missing. Choose an object made by an import or a training run."
        )
    sh_count(datablock, called=called)


def is_splats(name: str) -> bool:
    """True if the name is that of a splat attribute."""
    return name in (POSITION, SCALE, ROTATION, BASE) or name.startswith(SH)


def kind_of(name: str) -> str:
    """The data type of a splat attribute, as `write` creates it."""
    return {BASE: "FLOAT_COLOR", ROTATION: "QUATERNION"}.get(name, "FLOAT_VECTOR")


def add_points(mesh: Any, count: int) -> None:
    """Add points to a mesh; existing ones stay unchanged.

    New points are deselected, which Blender does not do: the live viewport tints selected splats.
    """
    chosen = np.append(selected(mesh), np.zeros(count, bool))
    mesh.vertices.add(count)
    if chosen.any():
        select(mesh, chosen)
    elif (selection := mesh.attributes.get(SELECTION)) is not None:
        mesh.attributes.remove(selection)


def has_selection(mesh: Any) -> bool:
    """True if `leave_points_unselected` was called for a mesh."""
    return _POINT_SELECTION in mesh.attributes


def leave_points_unselected(mesh: Any) -> None:
    """Show the points that nodes make from a mesh as deselected in Edit Mode.

    Blender 5 draws these points over the vertices of an edited mesh, as selected without the
    attribute. Nodes may not store one of that name, but keep the mesh's.

    Args:
        mesh: A writable mesh outside Edit Mode.
    """
    declare(mesh, _POINT_SELECTION, "BOOLEAN")


def selected(mesh: Any) -> np.ndarray:
    """[N] bool: the selected vertices of a mesh outside Edit Mode."""
    found = np.zeros(len(mesh.vertices), bool)
    if (selection := mesh.attributes.get(SELECTION)) is not None:
        selection.data.foreach_get("value", found)
    return found


def select(mesh: Any, chosen: np.ndarray) -> None:
    """Select the vertices `chosen` [N] bool of a mesh of points, and no others."""
    if SELECTION not in mesh.attributes:  # a hundred times faster than the vertices' flags
        mesh.attributes.new(SELECTION, "BOOLEAN", "POINT")
    mesh.attributes[SELECTION].data.foreach_set("value", chosen)


def _by_coefficient(shN: np.ndarray) -> np.ndarray:
    """[N, K, 3] float32 as a contiguous [K, N, 3]."""
    count, coefficients, _ = shN.shape
    found = np.empty((coefficients, count, 3), np.float32)
    if found.size:
        old, new = _triples(np.ascontiguousarray(shN)), _triples(found)
        for at in range(0, count, _BLOCK):  # a block fits the cache
            new[:, at : at + _BLOCK] = old[at : at + _BLOCK].T
    return found


def _by_splat(columns: list[np.ndarray], count: int) -> np.ndarray:
    """K arrays [N, 3] of contiguous float32, N = `count`, as [N, K, 3]."""
    found = np.empty((count, len(columns), 3), np.float32)
    if found.size:
        old, new = [_triples(c) for c in columns], _triples(found)
        for at in range(0, count, _BLOCK):
            for k, values in enumerate(old):
                new[at : at + _BLOCK, k] = values[at : at + _BLOCK]
    return found


def _triples(values: np.ndarray) -> np.ndarray:
    """View three floats as one element of twelve bytes, which numpy copies much faster."""
    return values.view("V12")[..., 0]
