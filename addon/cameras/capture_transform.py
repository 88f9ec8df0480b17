"""Capture transform: up direction, ground and size in the matrix of the capture's empty; its
footprint, and the sizes of its drawn cameras; the operators.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from bpy.props import EnumProperty, FloatProperty

from ..compat import matrix_to_numpy
from ..core import offset_between, rotmat_to_quat
from ..interface import editable_check, framing
from . import alignment, sfm_points
from . import objects as co
from .lookup import OnCapture, find_root, roots_of
from .objects import cameras_of

UP = "gs_up"
"""Property of the empty: up direction in the capture's world, if its files or EXIF state it."""
PHOTO_UP = "gs_held_up"
"""Property of the empty: up direction by its cameras, if EXIF has rotated photos."""
ORIGIN = "gs_origin"
"""Property of an empty, and of splats: the local origin of their world, in the coordinates of the
capture's files; without the property there is none."""
CLIP_START, CLIP_END = 0.002, 100.0
"""Clipping distances, in units of the cameras' extent."""
DISPLAY = 0.2
"""Display size of a camera, in median distances to the nearest other camera."""


def stated_up(root: bpy.types.Object, key: str = UP) -> np.ndarray | None:
    """[3], up in the world of a capture, stored as `UP` or `PHOTO_UP`; None: estimate it from the
    cameras."""
    return np.array(root[key][:], np.float64) if key in root else None


def origin_of(ob: bpy.types.Object | None) -> np.ndarray | None:
    """[3] float64, the local origin of an object's capture, or of splats without a capture; None:
    there is none."""
    return noted_origin(co.root_of(ob) or ob)


def noted_origin(ob: bpy.types.Object | None) -> np.ndarray | None:
    """[3] float64, the local origin stored on an object itself; None: none."""
    return None if ob is None or ORIGIN not in ob else np.array(ob[ORIGIN][:], np.float64)


def note_origin(ob: bpy.types.Object, origin: np.ndarray | None) -> None:
    """Store a local origin [3]; None: remove it."""
    ob.pop(ORIGIN, None)
    if origin is not None:
        ob[ORIGIN] = origin.tolist()


def box_of_capture(box: np.ndarray, ob: bpy.types.Object) -> np.ndarray:
    """[4, 4], a box in the world of an object's capture, converted to its files' coordinates."""
    out = box.copy()
    out[:3, 3] += offset_between(origin_of(ob), None)
    return out


def align_root(root: bpy.types.Object, up: np.ndarray | None = None) -> alignment.Alignment:
    """Estimate up and ground and set the matrix of a capture's empty, next to other captures; its
    scale stays.

    Args:
        root: The empty.
        up: [3], roughly up in the capture's world; None: estimated from the cameras.

    Raises:
        ValueError: the capture has no cameras.
    """
    cameras = cameras_of(root)
    if not cameras:
        raise ValueError(f"{root.name} has no cameras to align by. Import the capture again.")
    viewmats = np.stack([co.photo_camera_of(ob).viewmat for ob in cameras])
    made = co.points_of(root)
    cloud = np.zeros((0, 3)) if made is None else sfm_points.positions_of(made).astype(np.float64)
    result = alignment.align(viewmats, cloud, up)
    scale = root_scale(root)
    matrix = np.diag([scale, scale, scale, 1.0]) @ result.matrix
    others = [one for scene in root.users_scene for one in roots_of(scene) if one != root]
    if others:
        matrix = place_next_to(matrix, reach_of(matrix, cameras, made), others)
    set_root_matrix(root, matrix)
    return result


def world_extent(root: bpy.types.Object) -> float:
    """Largest distance between two of a capture's cameras, in Blender's units."""
    cameras = cameras_of(root)
    viewmats = np.array([co.photo_camera_of(ob).viewmat for ob in cameras]).reshape(-1, 4, 4)
    return alignment.camera_extent(alignment.camera_centers(viewmats)) * root_scale(root)


def set_extent(root: bpy.types.Object, extent: float) -> None:
    """Scale a capture about its empty until its outermost cameras are `extent` Blender units apart.

    Raises:
        ValueError: all cameras are in one place.
    """
    now = world_extent(root)
    if not (now > 0 and extent > 0):
        raise ValueError(
            f"The cameras of {root.name} are in one place, which gives no scale. Scale the empty."
        )
    matrix = matrix_to_numpy(root.matrix_basis)
    matrix[:3] *= extent / now
    set_root_matrix(root, matrix)
    size_drawings(root, cameras_of(root))


def root_scale(root: bpy.types.Object) -> float:
    """Blender units per unit of the capture's world."""
    return float(np.cbrt(abs(np.prod(np.array(root.scale[:], np.float64)))))


def set_root_matrix(root: bpy.types.Object, matrix: np.ndarray) -> None:
    """Set an empty's transform from a matrix [4, 4] of rotation, uniform scale and translation."""
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    root.rotation_mode = "QUATERNION"
    root.location = matrix[:3, 3]
    root.rotation_quaternion = rotmat_to_quat(matrix[:3, :3] / scale)
    root.scale = (scale, scale, scale)


@dataclass(frozen=True)
class Drawing:
    """Display sizes, in Blender units for an empty of scale 1."""

    length: float
    """Display size of a camera."""
    extent: float
    """Extent of all cameras."""


def drawing_of(centers: np.ndarray) -> Drawing:
    """Display sizes without overlap for camera positions [C, 3], C > 0; no bpy."""
    extent = alignment.camera_extent(centers) or 1.0
    few = centers[np.linspace(0, len(centers) - 1, min(200, len(centers))).astype(int)]
    distances = np.linalg.norm(few[:, None] - centers[None], axis=2)
    distances[distances == 0] = np.inf
    nearest = distances.min(axis=1)
    nearest = nearest[np.isfinite(nearest)]
    return Drawing(DISPLAY * float(np.median(nearest)) if len(nearest) else 0.1 * extent, extent)


def size_drawings(root: bpy.types.Object, cameras: list[bpy.types.Object]) -> None:
    """Set display sizes without overlap, and clipping distances that fit the capture's size."""
    if cameras:
        drawing = drawing_of(np.array([co.local_matrix(ob)[:3, 3] for ob in cameras]))
        scale = root_scale(root)
        for data in filter(editable_check.keeps, [ob.data for ob in cameras]):
            size_drawing(data, drawing, scale)
        root.empty_display_size = 0.1 * drawing.extent


def size_drawing(data: bpy.types.Camera, drawing: Drawing, scale: float) -> None:
    """Set them for one camera, below an empty of a given scale."""
    data.display_size = drawing.length * scale
    data.clip_start, data.clip_end = (
        end * drawing.extent * scale for end in (CLIP_START, CLIP_END)
    )


_POINTS = 20_000
"""Largest sample of points."""
_GAP = 0.1
"""Gap between captures, in widths of the new one."""


def frame_capture(scene: bpy.types.Scene, root: bpy.types.Object) -> list[bpy.types.SpaceView3D]:
    """Frame a capture's cameras and most of its points in the 3D views of a scene's windows;
    returns these views."""
    views = framing.views_of(scene)
    reach = reach_of(matrix_to_numpy(root.matrix_basis), *co.parts_of(root)) if views else []
    for space in views if len(reach) else ():
        framing.show_ball(space, *framing.ball(reach))
    return views


def reach_of(
    matrix: np.ndarray, cameras: Sequence[bpy.types.Object], points: bpy.types.Object | None
) -> np.ndarray:
    """[N, 3] float64 positions of a capture's cameras and points in Blender's world; cameras are
    repeated to equal the number of points.

    Args:
        matrix: [4, 4] of the capture's empty.
        cameras: Direct children of the empty.
        points: Direct child of the empty; None: no points. In Edit Mode they are ignored.
    """
    places = np.array([co.local_matrix(ob)[:3, 3] for ob in cameras]).reshape(-1, 3)
    if points is not None and points.mode != "EDIT" and len(points.data.vertices):
        cloud = sfm_points.positions_of(points).astype(np.float64)
        cloud = cloud[:: -(-len(cloud) // _POINTS)]
        if len(places):
            places = places[np.linspace(0, len(places) - 1, len(cloud)).astype(int)]
        places = np.concatenate([places, cloud])
    return places @ matrix[:3, :3].T + matrix[:3, 3]


def place_next_to(
    matrix: np.ndarray, reach: np.ndarray, others: Sequence[bpy.types.Object]
) -> np.ndarray:
    """[4, 4], the matrix of a capture's empty, moved along +x until the capture overlaps no other.

    Args:
        matrix: [4, 4] of the empty.
        reach: [N, 3] of `reach_of` for this matrix.
        others: Empties of the other captures.
    """
    taken = [_box(reach_of(matrix_to_numpy(o.matrix_basis), *co.parts_of(o))) for o in others]
    taken = sorted((box for box in taken if box is not None), key=lambda box: box[0, 0])
    own = _box(reach)
    if own is None:
        return matrix
    moved, gap = 0.0, _GAP * (own[1, 0] - own[0, 0])
    for low, high in taken:  # from left to right, so that one pass suffices
        if (own[0] < high).all() and (own[1] > low).all():
            step = high[0] - own[0, 0] + gap
            own[:, 0] += step
            moved += step
    out = matrix.copy()
    out[0, 3] += moved
    return out


def _box(reach: np.ndarray) -> np.ndarray | None:
    """[2, 2] lowest and highest x and y of the bulk of a capture; None: it is empty."""
    if not len(reach):
        return None
    return np.quantile(reach[:, :2], [(1 - framing.MOST) / 2, (1 + framing.MOST) / 2], axis=0)


_AXES = {"X": 0, "Y": 1, "Z": 2}


class _Aligning(OnCapture):
    """Base of operators that move the capture's empty and its children."""

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The empty."""
        return (find_root(context, self.capture),)


class AlignCapture(_Aligning, bpy.types.Operator):
    """Rotate a capture upright and put its ground at height 0; its scale stays"""

    bl_idname = "gscore.align_capture"
    bl_label = "Align to Ground"

    up: EnumProperty(
        name="Up",
        items=(
            (
                "CAPTURE",
                "From Capture",
                "From GPS or the EXIF orientation of the photos; without them From Cameras",
            ),
            ("CAMERAS", "From Cameras", "Assume that most photos were taken level"),
            ("CURRENT", "Current", "Keep the current up direction and find the ground again"),
            ("VIEW", "Scene Camera", "Upper side of the scene camera's picture"),
            ("X", "+X", "The capture's own x axis"),
            ("-X", "-X", "Opposite to the capture's own x axis"),
            ("Y", "+Y", "The capture's own y axis"),
            ("-Y", "-Y", "Opposite to the capture's own y axis, as in many COLMAP models"),
            ("Z", "+Z", "The capture's own z axis"),
            ("-Z", "-Z", "Opposite to the capture's own z axis"),
        ),
        description="Approximate up direction; the level plane with most points is the ground",
    )

    def run(self, context: bpy.types.Context) -> None:
        """Align."""
        root = find_root(context, self.capture)
        alignment = align_root(root, self._up(context, root))
        if not alignment.ground_found:
            self.report({"WARNING"}, "No ground was found; the lowest points are at height 0.")

    def _up(self, context: bpy.types.Context, root: bpy.types.Object) -> np.ndarray | None:
        if self.up == "CAPTURE":
            return stated_up(root)
        if self.up == "CAMERAS":
            return stated_up(root, PHOTO_UP)
        if self.up == "CURRENT":
            return current_up(root)
        if self.up == "VIEW":
            if context.scene.camera is None:
                raise ValueError("The scene has no camera. Choose one with Use Camera.")
            depsgraph = context.evaluated_depsgraph_get()
            return -co.viewmat_in(context.scene.camera, root, depsgraph)[1, :3]
        sign = -1.0 if self.up.startswith("-") else 1.0
        return sign * np.eye(3)[_AXES[self.up[-1]]]


class FlipUp(_Aligning, bpy.types.Operator):
    """Turn a capture upside down, and find the ground again"""

    bl_idname = "gscore.flip_up"
    bl_label = "Flip Up"

    def run(self, context: bpy.types.Context) -> None:
        """Flip."""
        root = find_root(context, self.capture)
        align_root(root, -current_up(root))


class SetExtent(_Aligning, bpy.types.Operator):
    """Scale a capture to real size, by the distance between its outermost cameras"""

    bl_idname = "gscore.set_extent"
    bl_label = "Set Size"

    extent: FloatProperty(
        name="Camera Extent",
        default=5.0,
        min=1e-4,
        soft_max=1000.0,
        subtype="DISTANCE",
        unit="LENGTH",
        description="Distance in meters between the two cameras that are farthest apart",
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Show a dialog with the current size."""
        try:
            self.extent = world_extent(find_root(context, self.capture))
        except ValueError as error:
            return self.refuse(error)
        return context.window_manager.invoke_props_dialog(self)

    def run(self, context: bpy.types.Context) -> None:
        """Scale."""
        set_extent(find_root(context, self.capture), self.extent)


class ResetAlignment(_Aligning, bpy.types.Operator):
    """Restore the axes, origin and scale of the capture's own files"""

    bl_idname = "gscore.reset_alignment"
    bl_label = "Reset to COLMAP World"

    def run(self, context: bpy.types.Context) -> None:
        """Reset."""
        root = find_root(context, self.capture)
        set_root_matrix(root, np.eye(4))
        size_drawings(root, co.cameras_of(root))


def current_up(root: bpy.types.Object) -> np.ndarray:
    """Blender's up [3] in a capture's world."""
    return np.linalg.inv(matrix_to_numpy(root.matrix_world)[:3, :3])[:, 2]
