"""Camera colors that show a result, and their restoration.

The color is the camera object's own, drawn in the viewport by `overlay`. The user's color is kept
in a custom property.
"""

import bpy

from .objects import cameras_of

MARK, _KEPT = "gs_colored", "gs_colors"
"""Custom properties of a colored camera: the purpose; the previous and the set color, RGBA each."""
_TOLERANCE = 1e-5


def own_cameras(root: bpy.types.Object) -> list[bpy.types.Object]:
    """Cameras of a capture that can be colored: linked ones and overrides keep no custom
    properties."""
    return [ob for ob in cameras_of(root) if ob.library is None and ob.override_library is None]


def set_color(ob: bpy.types.Object, mark: str, color: tuple[float, ...]) -> None:
    """Color a camera, linear RGBA; `mark` names the purpose."""
    take(ob)
    own = [float(v) for v in ob.color]
    ob.color = color
    ob[MARK], ob[_KEPT] = mark, [*own, *(float(v) for v in ob.color)]


def take(ob: bpy.types.Object) -> None:
    """Restore a camera's color, unless the user has changed it since."""
    if MARK not in ob:
        return
    kept = [float(v) for v in ob.get(_KEPT, ())]
    now = [float(v) for v in ob.color]
    if len(kept) == 8 and all(abs(a - b) < _TOLERANCE for a, b in zip(now, kept[4:], strict=True)):
        ob.color = kept[:4]
    del ob[MARK]
    if _KEPT in ob:
        del ob[_KEPT]


def mark_of(ob: bpy.types.Object) -> str:
    """Mark of a camera; empty: it is not colored."""
    return str(ob.get(MARK, ""))


def marks(root: bpy.types.Object) -> set[str]:
    """Marks of the cameras of a capture."""
    return {mark_of(ob) for ob in root.children_recursive} - {""}


def hide(root: bpy.types.Object) -> None:
    """Restore the colors of a capture's cameras."""
    for ob in own_cameras(root):
        take(ob)
