"""Camera math: Blender cameras <-> pinhole intrinsics and OpenCV poses, in float64; numpy only.

Pixels: origin at the upper left corner of the image, y down, pixel centres at +0.5. Poses: OpenCV
camera axes (+x right, +y down, +z forward) on one side, Blender's (+y up, -z forward) on the other.
"""

from dataclasses import dataclass

import numpy as np

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
"""Change between OpenCV and Blender camera axes; its own inverse."""

MIN_LENS = 1.0
"""Millimetres; Blender clamps `Camera.lens` below."""

_UNIT = 1e-9
"""Tolerance of K's last row and skew."""


@dataclass(frozen=True, kw_only=True)
class Lens:
    """Projection settings of a Blender camera, with Blender's names."""

    type: str = "PERSP"
    """PERSP or ORTHO."""
    lens: float = 50.0
    """Focal length, millimetres; PERSP only."""
    sensor_width: float = 36.0
    """Millimetres."""
    sensor_height: float = 24.0
    """Millimetres; used only by the fit VERTICAL."""
    sensor_fit: str = "AUTO"
    """AUTO, HORIZONTAL or VERTICAL."""
    shift_x: float = 0.0
    """Horizontal shift in units of the fitted side; positive moves the picture to the left."""
    shift_y: float = 0.0
    """Vertical shift in units of the fitted side; positive moves the picture down."""
    ortho_scale: float = 6.0
    """World units across the fitted side; ORTHO only."""


@dataclass(frozen=True, kw_only=True)
class Frame:
    """The picture's raster."""

    width: int
    """Pixels, after the resolution percentage."""
    height: int
    """Pixels, after the resolution percentage."""
    pixel_aspect_x: float = 1.0
    """Width of a pixel relative to `pixel_aspect_y`."""
    pixel_aspect_y: float = 1.0
    """Height of a pixel relative to `pixel_aspect_x`."""


def frame_size(resolution_x: int, resolution_y: int, percentage: int) -> tuple[int, int]:
    """Width and height of Blender's render, rounded down."""
    return resolution_x * percentage // 100, resolution_y * percentage // 100


def intrinsics(lens: Lens, frame: Frame) -> np.ndarray:
    """K of a Blender camera, [3, 3] float64.

    For PERSP, pixels. For ORTHO, K[0, 0] and K[1, 1] are pixels per world unit and a point at
    camera x, y projects to (K[0, 0] x + K[0, 2], K[1, 1] y + K[1, 2]) for any z.

    Raises:
        ValueError: another camera type, or a size or lens that is not positive.
    """
    side, stretch = fitted_side(lens, frame), frame.pixel_aspect_x / frame.pixel_aspect_y
    if lens.type == "PERSP":
        sensor = lens.sensor_height if lens.sensor_fit == "VERTICAL" else lens.sensor_width
        focal = lens.lens / sensor * side
    elif lens.type == "ORTHO":
        focal = side / lens.ortho_scale
    else:
        raise ValueError(f"A camera of type {lens.type} has no K; use PERSP or ORTHO.")
    if not (np.isfinite(focal) and focal > 0):
        raise ValueError(f"Focal length must be positive and finite, got {focal} px from {lens}.")
    K = np.eye(3)
    K[0, 0], K[1, 1] = focal, focal * stretch
    K[0, 2] = frame.width / 2 - lens.shift_x * side
    K[1, 2] = frame.height / 2 + lens.shift_y * side * stretch
    return K


def lens_from_intrinsics(
    K: np.ndarray,
    width: int,
    height: int,
    *,
    sensor_width: float = 36.0,
    orthographic: bool = False,
) -> tuple[Lens, Frame]:
    """The Blender camera with a given K: the inverse of `intrinsics`.

    fx != fy goes into the pixel aspect, which Blender stores per scene and clamps to at least 1.
    The sensor is widened if the lens would be shorter than Blender's minimum of 1 mm.

    Args:
        K: [3, 3] float, as `intrinsics` returns it.
        width: Pixels.
        height: Pixels.
        sensor_width: Millimetres; any value gives the same picture.
        orthographic: K is in pixels per world unit.

    Raises:
        ValueError: K is not finite, skewed or not positive, or the size is not positive.
    """
    K = np.asarray(K, np.float64)
    bare = K.copy()
    bare[[0, 1, 0, 1], [0, 1, 2, 2]] = 0
    if K.shape != (3, 3) or not np.isfinite(K).all() or min(K[0, 0], K[1, 1]) <= 0:
        raise ValueError(f"K must be 3 x 3, finite, with positive focal lengths, got {K.tolist()}.")
    if np.abs(bare - np.diag([0.0, 0.0, 1.0])).max() > _UNIT:
        raise ValueError(f"Blender cameras have no skew, got K = {K.tolist()}.")
    if min(width, height) <= 0:
        raise ValueError(f"The size must be positive, got {width} x {height} pixels.")
    fx, fy = K[0, 0], K[1, 1]
    stretch = fy / fx
    frame = Frame(
        width=width,
        height=height,
        pixel_aspect_x=max(stretch, 1.0),
        pixel_aspect_y=max(1 / stretch, 1.0),
    )
    sensor_width = max(sensor_width, MIN_LENS * width / fx)
    lens = Lens(
        type="ORTHO" if orthographic else "PERSP",
        lens=Lens.lens if orthographic else fx * sensor_width / width,
        sensor_width=sensor_width,
        sensor_fit="HORIZONTAL",
        shift_x=(width / 2 - K[0, 2]) / width,
        shift_y=(K[1, 2] - height / 2) / (width * stretch),
        ortho_scale=width / fx if orthographic else Lens.ortho_scale,
    )
    return lens, frame


def viewmat_from_matrix_world(matrix_world: np.ndarray) -> np.ndarray:
    """World to camera, OpenCV axes, of a Blender camera's `matrix_world`; both [4, 4] float64.

    The object's scale is ignored as in Blender: columns are normalised, then the matrix inverted.
    For a sheared camera the result matches Blender's render, but is not a rotation.

    Raises:
        ValueError: the matrix is not finite or has no inverse.
    """
    matrix = np.array(matrix_world, np.float64)
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all() or lengths.min() <= 0:
        raise ValueError(f"A camera's matrix must be finite and not flat, got {matrix.tolist()}.")
    matrix[:3, :3] /= lengths
    if abs(np.linalg.det(matrix[:3, :3])) < 1e-6:
        raise ValueError(f"A camera's matrix must not be flat, got {matrix.tolist()}.")
    inverse = np.eye(4)
    inverse[:3, :3] = np.linalg.inv(matrix[:3, :3])
    inverse[:3, 3] = -inverse[:3, :3] @ matrix[:3, 3]
    return FLIP @ inverse


def matrix_world_from_viewmat(viewmat: np.ndarray) -> np.ndarray:
    """A Blender camera's `matrix_world` from a rigid world-to-camera matrix [4, 4], OpenCV axes."""
    viewmat = np.asarray(viewmat, np.float64)
    matrix = np.eye(4)
    matrix[:3, :3] = viewmat[:3, :3].T
    matrix[:3, 3] = -viewmat[:3, :3].T @ viewmat[:3, 3]
    return matrix @ FLIP


def project(
    points: np.ndarray, K: np.ndarray, viewmat: np.ndarray, *, orthographic: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels [P, 2] and depths [P] (camera z) of world points [P, 3], in the inputs' precision."""
    camera = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    plane = camera[:, :2] if orthographic else camera[:, :2] / camera[:, 2:]
    return plane * K[[0, 1], [0, 1]] + K[:2, 2], camera[:, 2]


def fitted_side(lens: Lens, frame: Frame) -> float:
    """Side of the picture that the sensor spans, in pixel widths."""
    if min(frame.width, frame.height) <= 0:
        raise ValueError(f"The size must be positive, got {frame.width} x {frame.height} pixels.")
    width = frame.width * frame.pixel_aspect_x
    height = frame.height * frame.pixel_aspect_y
    if lens.sensor_fit == "HORIZONTAL" or (lens.sensor_fit == "AUTO" and width >= height):
        return float(frame.width)
    return height / frame.pixel_aspect_x
