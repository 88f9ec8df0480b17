"""Camera objects of photos: their marking, creation and reading."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from .. import stored_paths
from ..compat import matrix_to_numpy
from ..core import rotmat_to_quat
from . import camera_math as cm

KIND = "gs_kind"
"""Custom property with the kind of an object: capture, camera, points or splats."""
TURNED, MOVED = "gs_turned_degrees", "gs_moved"
"""Custom properties of a camera whose pose a training refined: degrees, and world units of the
capture."""
_TURN, _MOVE, _LENS = 1e-5, 1e-6, 1e-6
"""Tolerances of unmoved cameras for Blender's single precision: radians, and relative."""

_PLAIN = {
    "scale": (1.0, 1.0, 1.0),
    "delta_location": (0.0, 0.0, 0.0),
    "delta_rotation_euler": (0.0, 0.0, 0.0),
    "delta_rotation_quaternion": (1.0, 0.0, 0.0, 0.0),
    "delta_scale": (1.0, 1.0, 1.0),
}
"""Values of the transforms other than location and rotation that have no effect."""


@dataclass(frozen=True, kw_only=True)
class PhotoCamera:
    """Camera of one photo in the capture; stored in custom properties, in float64."""

    image: str
    """Name in the capture, sub-folders with '/'."""
    photo: str
    """File of the photo, absolute."""
    viewmat: np.ndarray
    """[4, 4], world to camera, OpenCV axes, in the capture's world."""
    K: np.ndarray
    """[3, 3], pixels; of the undistorted photo for a lens with distortion."""
    width: int
    """Pixels."""
    height: int
    """Pixels."""
    model: str = "PINHOLE"
    """COLMAP's name of the camera model."""
    params: tuple[float, ...] = ()
    """Parameters of the model in COLMAP's order."""
    photo_size: tuple[int, int] | None = None
    """Width and height of the photo before undistortion, pixels; None: the lens has no distortion,
    or it cannot be undistorted."""

    @property
    def taken(self) -> tuple[int, int]:
        """Width and height of the original photo, pixels."""
        return self.photo_size or (self.width, self.height)


def is_kind(ob: bpy.types.Object | None, kind: str) -> bool:
    """True if an object has a mark of the add-on."""
    return ob is not None and ob.get(KIND) == kind


def is_camera(ob: bpy.types.Object | None) -> bool:
    """True if an object is the camera of a photo."""
    return is_kind(ob, "camera") and ob.type == "CAMERA"


def root_of(ob: bpy.types.Object | None) -> bpy.types.Object | None:
    """The empty of the capture that an object belongs to, or None."""
    while ob is not None and not is_kind(ob, "capture"):
        ob = ob.parent
    return ob


def cameras_of(root: bpy.types.Object) -> list[bpy.types.Object]:
    """The photos' cameras below a capture's empty, by image name."""
    return by_image(filter(is_camera, root.children_recursive))


def by_image(cameras: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    """Photos' cameras in the order of their images."""
    return sorted(cameras, key=lambda ob: (str(ob.get("gs_image", "")), ob.name))


def points_of(root: bpy.types.Object) -> bpy.types.Object | None:
    """The object of a capture's points, or None."""
    return find_points(root.children)


def parts_of(
    root: bpy.types.Object,
) -> tuple[list[bpy.types.Object], bpy.types.Object | None]:
    """`cameras_of` and `points_of` with a single search, because Blender scans all objects for the
    children of one."""
    below = root.children_recursive
    points = find_points(ob for ob in below if ob.parent == root)
    return by_image(filter(is_camera, below)), points


def find_points(obs: Iterable[bpy.types.Object]) -> bpy.types.Object | None:
    """The first object of a capture's points, or None."""
    return next((ob for ob in obs if is_kind(ob, "points") and ob.type == "MESH"), None)


@dataclass(frozen=True, kw_only=True)
class Setup:
    """Blender camera values of a photo."""

    own: PhotoCamera
    """The camera."""
    lens: cm.Lens
    location: np.ndarray
    """[3] in the capture's world."""
    rotation: np.ndarray
    """[4] quaternion wxyz, in the capture's world."""


def setup_of(own: PhotoCamera) -> Setup:
    """Compute the values; no bpy."""
    lens, _ = cm.lens_from_intrinsics(own.K, own.width, own.height)
    matrix = cm.matrix_world_from_viewmat(own.viewmat)
    rotation = rotmat_to_quat(matrix[:3, :3])
    return Setup(own=own, lens=lens, location=matrix[:3, 3], rotation=rotation)


def make(setup: Setup, name: str, collection: bpy.types.Collection) -> bpy.types.Object:
    """A Blender camera with a photo's pose and intrinsics."""
    ob = bpy.data.objects.new(name, bpy.data.cameras.new(name))
    collection.objects.link(ob)
    apply_changes(ob, changes_of(ob, setup))
    return ob


@dataclass(frozen=True, kw_only=True)
class CameraChanges:
    """Changes to write to a camera; no bpy."""

    lens: dict[str, Any]
    """Properties of the camera datablock."""
    place: dict[str, Any]
    """Properties of the object."""
    properties: dict[str, Any]
    """Custom properties; None: the object has an extra one."""


def changes_of(ob: bpy.types.Object, setup: Setup) -> CameraChanges:
    """Changes that give a camera a photo's pose, intrinsics and custom properties, except
    `gs_photo`; Blender writes several times slower than it compares."""
    own, size = setup.own, setup.own.photo_size
    properties = {
        KIND: "camera",
        "gs_image": own.image,
        "gs_K": own.K.ravel().tolist(),
        "gs_viewmat": own.viewmat.ravel().tolist(),
        "gs_size": [own.width, own.height],
        "gs_model": own.model,
        "gs_params": list(own.params),
        "gs_photo_size": None if size is None else list(size),
    }
    return CameraChanges(
        lens=lens_changes(ob.data, setup.lens),
        place=_place_changes(ob, setup.location, setup.rotation),
        properties={key: v for key, v in properties.items() if _as_list(ob.get(key)) != v},
    )


def apply_changes(ob: bpy.types.Object, changes: CameraChanges) -> None:
    """Write the changes."""
    for owner, values in ((ob.data, changes.lens), (ob, changes.place)):
        for name, value in values.items():
            setattr(owner, name, value)
    for name, value in changes.properties.items():
        if value is None:
            ob.pop(name, None)
        else:
            ob[name] = value


def _as_list(value: Any) -> Any:
    return value.to_list() if hasattr(value, "to_list") else value


def is_as_stated(ob: bpy.types.Object, setup: Setup) -> bool:
    """True if `changes_of` a camera would have no effect."""
    try:
        own = photo_camera_of(ob)
    except ValueError:
        return False
    now, then = vars(own), vars(setup.own)
    same = all(np.array_equal(now[key], then[key]) for key in now if key != "photo")
    return same and not is_moved(ob, own) and not is_lens_changed(ob.data, own)


def photo_camera_of(ob: bpy.types.Object) -> PhotoCamera:
    """The photo camera of an object, the argument of `make`.

    Raises:
        ValueError: a custom property is missing or invalid.
    """
    try:
        width, height = (int(v) for v in ob["gs_size"])
        taken = ob.get("gs_photo_size")
        return PhotoCamera(
            image=str(ob["gs_image"]),
            photo=stored_paths.read(ob, stored_paths.PHOTO),
            viewmat=np.array(ob["gs_viewmat"], np.float64).reshape(4, 4),
            K=np.array(ob["gs_K"], np.float64).reshape(3, 3),
            width=width,
            height=height,
            model=str(ob.get("gs_model", "PINHOLE")),
            params=tuple(float(v) for v in ob.get("gs_params", ())),
            photo_size=None if taken is None else (int(taken[0]), int(taken[1])),
        )
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise ValueError(
            f"Camera {ob.name} has lost a custom property of its capture ({error}). "
            f"Import the capture again."
        ) from error


def note_moves(root: bpy.types.Object, moves: Mapping[str, tuple[float, float]]) -> None:
    """Store how far a training moved the cameras below `root`, in custom properties `TURNED` and
    `MOVED`; removes them from other cameras.

    Args:
        root: The empty of the capture.
        moves: Degrees and distance by image name.
    """
    for ob in cameras_of(root):
        move = moves.get(str(ob.get("gs_image")))
        for key, value in zip((TURNED, MOVED), move or (None, None), strict=True):
            if value is None:
                ob.pop(key, None)
            else:
                ob[key] = value


def lens_changes(data: bpy.types.Camera, lens: cm.Lens) -> dict[str, Any]:
    """Properties of a camera datablock to change for a lens."""
    values = {"lens_unit": "MILLIMETERS", **vars(lens)}
    single = {k: float(np.float32(v)) if isinstance(v, float) else v for k, v in values.items()}
    return {name: value for name, value in single.items() if getattr(data, name) != value}


def lens_of(data: bpy.types.Camera) -> cm.Lens:
    """The lens of a camera datablock."""
    return cm.Lens(
        type=data.type,
        lens=data.lens,
        sensor_width=data.sensor_width,
        sensor_height=data.sensor_height,
        sensor_fit=data.sensor_fit,
        shift_x=data.shift_x,
        shift_y=data.shift_y,
        ortho_scale=data.ortho_scale,
    )


def frame_of(
    scene: bpy.types.Scene, width: int | None = None, height: int | None = None
) -> cm.Frame:
    """Render raster of a scene, or another size with the scene's pixel aspect."""
    render = scene.render
    own = cm.frame_size(render.resolution_x, render.resolution_y, render.resolution_percentage)
    return cm.Frame(
        width=own[0] if width is None else width,
        height=own[1] if height is None else height,
        pixel_aspect_x=render.pixel_aspect_x,
        pixel_aspect_y=render.pixel_aspect_y,
    )


def is_moved(ob: bpy.types.Object, own: PhotoCamera) -> bool:
    """True if a photo's camera was moved from its pose in the capture."""
    if not is_plain_child(ob):
        return True
    now, then = local_matrix(ob), cm.matrix_world_from_viewmat(own.viewmat)
    far = np.abs(now[:3, 3] - then[:3, 3]).max() > _MOVE * np.linalg.norm(then[:3, 3])
    return bool(far or np.abs(now[:3, :3] - then[:3, :3]).max() > _TURN)


def is_lens_changed(data: bpy.types.Camera, own: PhotoCamera) -> bool:
    """True if the K of a photo's camera differs from the photo's."""
    lens, frame = cm.lens_from_intrinsics(own.K, own.width, own.height)
    try:
        now = cm.intrinsics(lens_of(data), frame)
    except ValueError:
        return True
    return data.type != lens.type or bool(
        np.abs(now - own.K).max() > _LENS * (own.K[0, 0] + own.width + own.height)
    )


def local_matrix(ob: bpy.types.Object) -> np.ndarray:
    """[4, 4] in the parent's space, without constraints and animation not yet applied."""
    return matrix_to_numpy(ob.matrix_parent_inverse) @ matrix_to_numpy(ob.matrix_basis)


def viewmat_in(
    ob: bpy.types.Object, root: bpy.types.Object | None, depsgraph: bpy.types.Depsgraph | None
) -> np.ndarray:
    """Current world-to-camera matrix [4, 4] of a camera, in the capture's world; without `root` in
    Blender's.

    Raises:
        ValueError: the camera is mirrored or sheared, or the capture's empty is flat.
    """
    if root is not None and ob.parent == root and is_plain_child(ob):
        matrix = local_matrix(ob)
    else:
        matrix = _evaluated_matrix(ob, depsgraph)
        if root is not None:
            base = _evaluated_matrix(root, depsgraph)
            if abs(np.linalg.det(base[:3, :3])) < 1e-30:
                raise ValueError(f"{root.name} is scaled to nothing; reset its alignment.")
            matrix = np.linalg.inv(base) @ matrix
    return rigid_viewmat(matrix, ob.name)


def rigid_viewmat(matrix: np.ndarray, name: str) -> np.ndarray:
    """World to camera of a camera's matrix [4, 4], checked to be a rigid transform.

    Raises:
        ValueError: the camera is mirrored, sheared or flat.
    """
    try:
        viewmat = cm.viewmat_from_matrix_world(matrix)
    except ValueError as error:
        raise ValueError(f"Camera {name} is scaled to nothing; set its scale to 1.") from error
    rotation = viewmat[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-4 or np.linalg.det(rotation) < 0:
        raise ValueError(
            f"Camera {name} is mirrored or sheared by its own or its parents' scale; give them one "
            f"positive scale for all axes."
        )
    return viewmat


def _place_changes(
    ob: bpy.types.Object, location: np.ndarray, rotation: np.ndarray
) -> dict[str, Any]:
    """Properties to change for a pose, as exact as Blender's single precision allows."""
    values = {
        "rotation_mode": "QUATERNION",  # Euler angles lose up to 5e-6 rad
        "location": tuple(location.astype(np.float32).tolist()),
        "rotation_quaternion": tuple(rotation.astype(np.float32).tolist()),
        **_PLAIN,
    }
    changes = {n: value for n, value in values.items() if tuple(getattr(ob, n)) != tuple(value)}
    if "rotation_mode" in changes:  # a change of it overwrites the quaternion
        changes["rotation_quaternion"] = values["rotation_quaternion"]
    return changes


def is_plain_child(ob: bpy.types.Object) -> bool:
    """True if an object is a child of a capture's empty and nothing else moves it."""
    moves = animation = ob.animation_data
    if animation is not None:
        moves = animation.action is not None or animation.drivers or animation.nla_tracks
    free = ob.parent_type == "OBJECT" and not ob.constraints
    return is_kind(ob.parent, "capture") and free and not moves


def _evaluated_matrix(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None) -> np.ndarray:
    return matrix_to_numpy((ob.evaluated_get(depsgraph) if depsgraph else ob).matrix_world)
