"""Camera colors that show a result, their restoration, and their drawing in the viewport.

The color is the camera object's own. The user's color is kept
in a custom property.
"""

from typing import Any

import bpy
import gpu
import numpy as np
from bpy.props import BoolProperty
from gpu_extras.batch import batch_for_shader

from ..interface.base_operator import Undoable
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


class ShowsColors(Undoable):
    """Base of operators that color cameras, or restore their colors."""

    show: BoolProperty(
        name="Show",
        description="Color the cameras; off: restore their colors",
        default=True,
        options={"SKIP_SAVE"},
    )


LINE_WIDTH = 2.5
"""Line width in pixels at interface scale 1."""
FILL = 0.25
"""Opacity of the image plane."""
_NEARER = 2e-5
"""Depth offset in normalised device coordinates."""
_EDGES = np.array([(0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1)])
_FACES = np.array([(1, 2, 3), (1, 3, 4)])


def corners(cameras: list[bpy.types.Object], scene: bpy.types.Scene) -> np.ndarray:
    """[C, 5, 3] positions of C cameras and the corners of their drawn frames, Blender's world."""
    frames = np.array([[tuple(c) for c in ob.data.view_frame(scene=scene)] for ob in cameras])
    matrices = np.array([[tuple(row) for row in ob.matrix_world] for ob in cameras])
    sides = np.abs(frames[..., :2] - frames[..., :2].mean(axis=1, keepdims=True)).max(axis=(1, 2))
    scales = np.linalg.norm(matrices[:, :3, :3], axis=1).mean(axis=1)
    drawn = np.array([ob.data.display_size for ob in cameras]) / (2 * sides * scales)
    ortho = np.array([ob.data.type == "ORTHO" for ob in cameras])
    frames *= np.where(ortho, 1.0, drawn)[:, None, None]
    local = np.concatenate([np.zeros((len(cameras), 1, 3)), frames], axis=1)
    return local @ matrices[:, :3, :3].transpose(0, 2, 1) + matrices[:, None, :3, 3]


def geometry(
    cameras: list[bpy.types.Object], scene: bpy.types.Scene
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Lines and faces of C cameras; the S selected ones keep Blender's lines.

    Returns:
        Lines [16 (C - S), 3] with colors [16 (C - S), 4] and triangles [6 C, 3] with colors
        [6 C, 4], float32, Blender's world, linear RGBA.
    """
    points = corners(cameras, scene).astype(np.float32)
    colors = np.array([tuple(ob.color) for ob in cameras], np.float32)
    pale = colors * np.float32([1, 1, 1, FILL])
    lined = np.array([not ob.select_get() for ob in cameras])
    return (
        points[lined][:, _EDGES.ravel()].reshape(-1, 3),
        np.repeat(colors[lined], _EDGES.size, axis=0),
        points[:, _FACES.ravel()].reshape(-1, 3),
        np.repeat(pale, _FACES.size, axis=0),
    )


def draw() -> None:
    """Draw the overlay; called by Blender for each 3D view, after its own overlays."""
    context, space = bpy.context, bpy.context.space_data
    if not (space.overlay.show_overlays and space.overlay.show_extras):
        return
    through = space.camera if space.region_3d.view_perspective == "CAMERA" else None
    cameras = [
        ob
        for ob in context.view_layer.objects
        if ob.type == "CAMERA" and MARK in ob and ob != through and ob.visible_get(viewport=space)
    ]
    if not cameras:
        return
    fill, lines = _drawing.batches(*geometry(cameras, context.scene))
    width = LINE_WIDTH * context.preferences.system.ui_scale
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("LESS_EQUAL")
    with gpu.matrix.push_pop_projection():
        projection = gpu.matrix.get_projection_matrix()
        projection[2] -= _NEARER * projection[3]  # so that Blender's lines do not show through
        gpu.matrix.load_projection_matrix(projection)
        fill[0].bind()
        fill[1].draw(fill[0])
        lines[0].bind()
        lines[0].uniform_float("viewportSize", gpu.state.viewport_get()[2:])
        lines[0].uniform_float("lineWidth", width)
        lines[1].draw(lines[0])
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("NONE")


class _Drawing:
    """The last batches."""

    def __init__(self) -> None:
        self._key: tuple[bytes, ...] = ()
        self._made: tuple[Any, Any] = ((), ())

    def clear(self) -> None:
        """Drop the batches."""
        self.__init__()

    def batches(
        self,
        edges: np.ndarray,
        edge_colors: np.ndarray,
        faces: np.ndarray,
        face_colors: np.ndarray,
    ) -> tuple[Any, Any]:
        """Shader and batch of the planes, and of the lines; cached until something changes."""
        key = (edges.tobytes(), edge_colors.tobytes(), faces.tobytes(), face_colors.tobytes())
        if self._key != key:
            flat = gpu.shader.from_builtin("FLAT_COLOR")
            thick = gpu.shader.from_builtin("POLYLINE_FLAT_COLOR")
            planes = batch_for_shader(flat, "TRIS", {"pos": faces, "color": face_colors})
            lines = batch_for_shader(thick, "LINES", {"pos": edges, "color": edge_colors})
            self._key, self._made = key, ((flat, planes), (thick, lines))
        return self._made


_drawing = _Drawing()
DRAWING = ((draw, "POST_VIEW"),)
on_unregister = _drawing.clear
