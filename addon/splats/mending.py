"""Shapes and colors of splats brought after their places, and stretching taken back: see `lag`."""

import bpy
import numpy as np
from mathutils import Matrix

from .. import attributes
from ..interface import writable
from . import lag, objects, parts
from .fitted import is_similarity
from .turning import turn_along

APPLIED = (
    "The places of the splats of {} were turned or scaled alone, as Apply of Blender does: their "
    "shapes and colors are as before."
)
JOINED = (
    "Join of Blender turned or scaled the places of what {} took in, but not its shapes and colors."
)
STRETCHED = (
    "The places of splats of {} were stretched by Apply or Join of Blender, and splats cannot be: "
    "their shapes are as before."
)


def problem(ob: bpy.types.Object) -> str:
    """What lags behind in a splat object, a sentence with `{}` for its name; empty where nothing
    does. Quick enough for drawing a panel."""
    if not lag.is_behind(ob.data):
        return ""
    lags = lag.of(ob.data)
    if not all(map(is_similarity, lags)):
        return STRETCHED
    return JOINED if len(lags) > 1 else APPLIED


def behind(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The splat objects in which something lags: the one that is worked on, and those selected."""
    obs = dict.fromkeys([objects.meant(context), *context.selected_objects])
    return [ob for ob in obs if objects.is_splats(ob) and lag.is_behind(ob.data)]


def mend(ob: bpy.types.Object) -> list[bpy.types.Object]:
    """Turn and scale shapes and colors along with the places that are there.

    What was stretched gets the places of before instead, and its object that matrix; a part that
    was joined becomes an object of its own for that.

    Returns:
        The objects that are stretched now, as before Apply or Join.

    Raises:
        ValueError: Edit Mode, a mesh that cannot be written, or what happened cannot be undone so;
            nothing is changed then.
    """
    objects.check_writable(ob)
    objects.catch_up(ob)
    lags, numbers = lag.of(ob.data), lag.parts(ob.data)
    there = np.unique(numbers)
    odd = [k for k in there if not is_similarity(lags[k])]
    for k in odd:
        for user in _users(ob):
            writable.check(user)
            _with_lag(user, lags[k])
    if len(odd) < len(there):
        turn_along(ob.data, lags, np.where(np.isin(numbers, odd), -1, numbers))
    own = odd[:1] if len(odd) == len(there) else []  # one part stays where it is
    taken = [ob] * len(own) + [_apart(ob, k) for k in odd[len(own) :]]
    for one, k in zip(taken, odd, strict=True):
        _take_back(one, lags[k])
    for one in {ob, *taken}:
        lag.forget(one.data)
        lag.follow(one.data)
    return taken


def _apart(ob: bpy.types.Object, part: int) -> bpy.types.Object:
    return parts.separate(ob, lag.parts(ob.data) == part)


def _users(ob: bpy.types.Object) -> list[bpy.types.Object]:
    """All objects that show an object's mesh."""
    return [one for one in bpy.data.objects if one.data == ob.data]


def _with_lag(ob: bpy.types.Object, turn: np.ndarray) -> Matrix:
    """The matrix that an object gets when its splats give a lag back to it.

    Raises:
        ValueError: there is none: something was scaled to nothing, or sheared.
    """
    if abs(np.linalg.det(turn)) > 1e-12:
        wanted = ob.matrix_basis @ _matrix(turn)
        made = Matrix.LocRotScale(*wanted.decompose())
        if np.allclose(made, wanted, rtol=0, atol=1e-5 * np.abs(np.array(wanted)[:3, :3]).max()):
            return made
    raise ValueError(
        f"{ob.name} was stretched in a way that no object can be: undo the Apply or Join (Ctrl Z)."
    )


def _take_back(ob: bpy.types.Object, turn: np.ndarray) -> None:
    """Give splats the places of before, and the objects that show them the lag as their own; what
    hangs from these stays."""
    back = np.linalg.inv(turn)
    places = attributes.column(ob.data, attributes.POSITION).astype(np.float64) @ back.T
    kind = ob.data.attributes[attributes.POSITION].data_type
    attributes.fill(ob.data, attributes.POSITION, kind, places.astype(np.float32).ravel())
    ob.data.update()
    for user in _users(ob):
        for child in user.children:
            child.matrix_parent_inverse = _matrix(back) @ child.matrix_parent_inverse
        user.matrix_basis = _with_lag(user, turn)


def _matrix(turn: np.ndarray) -> Matrix:
    return Matrix(turn.tolist()).to_4x4()
