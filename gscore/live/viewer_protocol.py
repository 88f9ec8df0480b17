"""Viewer protocol: frame requests of a viewer, validated, and the answer.

A request is a length, four bytes little-endian, and that number of bytes of a JSON object:

    resolution_x, resolution_y       px; 0: no picture
    fov_x, fov_y                     radians, of the whole width and height
    view_matrix                      16 numbers, column after column: world to camera with the axes
                                     of OpenGL (y up, z backwards)
    train                            0: pause the training
    keep_alive                       1: keep answering after the last step
    scaling_modifier                 factor on the sizes of splats

and others that are ignored: view_projection_matrix, z_near, z_far, shs_python, rot_scale_python. An
answer is the picture, if requested, as 3 bytes per pixel, RGB, rows from the top; then the length
of a text, four bytes little-endian, and the text: the capture's folder.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..json_text import parse_json
from ..scene import FARTHEST

LENGTH = 4
"""Bytes of a length field."""
LONGEST = 1 << 16
"""Maximum size of a request, bytes; the viewer's have about a thousand."""
LARGEST_PICTURE = 3840 * 2160
"""Maximum number of pixels."""
_LONGEST_SIDE = 8192
_FOV = (1e-3, math.pi - 1e-3)
"""Radians."""
_SCALING = (1e-4, 1.0)
_SKEWED = 1e-2
"""Maximum error of a rotation times its transpose, because viewers compute in float32."""


@dataclass(frozen=True, kw_only=True)
class FrameRequest:
    """Frame request of one viewer."""

    width: int
    """Width, px; 0: no picture."""
    height: int
    """Height, px."""
    viewmat: np.ndarray
    """[4, 4] float64, world to camera, OpenCV axes."""
    K: np.ndarray
    """[3, 3] float64, px."""
    scaling: float
    """Factor on the splats' sizes."""
    trains: bool
    """Whether the training may continue."""
    stays: bool
    """Whether the viewer stays after the last step."""


def length_of(head: bytes) -> int:
    """Decode the length of a request from four bytes.

    Raises:
        ValueError: the length is invalid.
    """
    length = int.from_bytes(head, "little")
    if not 0 < length <= LONGEST:
        raise ValueError(f"a request of {length} bytes")
    return length


def parse(text: bytes) -> FrameRequest:
    """Parse and validate a request.

    Raises:
        ValueError: it is malformed or has an invalid camera; the message names the field.
    """
    try:
        content = parse_json(text)
    except (ValueError, RecursionError) as error:
        raise ValueError("no JSON") from error
    if not isinstance(content, dict):
        raise ValueError("no JSON object")
    width, height = (_size(content, f"resolution_{axis}") for axis in "xy")
    trains, stays = (bool(_number(content, key, 0)) for key in ("train", "keep_alive"))
    if not (width and height):
        nothing = {"width": 0, "height": 0, "viewmat": np.eye(4), "K": np.eye(3), "scaling": 1.0}
        return FrameRequest(**nothing, trains=trains, stays=stays)
    if width * height > LARGEST_PICTURE:
        raise ValueError(f"a picture of {width} x {height} px")
    fov_x, fov_y = (_number(content, f"fov_{axis}", within=_FOV) for axis in "xy")
    focal = width / 2 / math.tan(fov_x / 2), height / 2 / math.tan(fov_y / 2)
    return FrameRequest(
        width=width,
        height=height,
        viewmat=_viewmat(content),
        K=np.array([[focal[0], 0, width / 2], [0, focal[1], height / 2], [0, 0, 1.0]]),
        scaling=_number(content, "scaling_modifier", 1.0, within=_SCALING),
        trains=trains,
        stays=stays,
    )


def answer(picture: bytes, text: str) -> bytes:
    """The bytes of an answer; `picture` is empty if not requested."""
    encoded = text.encode("utf-8", "replace")
    return picture + len(encoded).to_bytes(LENGTH, "little") + encoded


def _number(
    content: dict[str, Any],
    key: str,
    default: float | None = None,
    *,
    within: tuple[float, float] = (-math.inf, math.inf),
) -> float:
    value = content.get(key, default)
    if not isinstance(value, int | float) or not within[0] <= value <= within[1]:
        raise ValueError(f"{key} of {value!r:.40}")
    return float(value)


def _size(content: dict[str, Any], key: str) -> int:
    value = content.get(key)
    if type(value) is not int or not 0 <= value <= _LONGEST_SIDE:
        raise ValueError(f"{key} of {value!r:.40}")
    return value


def _viewmat(content: dict[str, Any]) -> np.ndarray:
    values = content.get("view_matrix")
    if not isinstance(values, list) or len(values) != 16:
        raise ValueError("no view_matrix of 16 numbers")
    if not all(isinstance(value, int | float) for value in values):
        raise ValueError("a view_matrix that is not of numbers")
    matrix = np.array(values, np.float64).reshape(4, 4).T
    viewmat = np.diag([1.0, -1.0, -1.0, 1.0]) @ matrix
    rotation = viewmat[:3, :3]
    if not (np.abs(viewmat) <= FARTHEST).all():  # NaN is not
        raise ValueError("a view_matrix that is not finite")
    off = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if off > _SKEWED or np.linalg.det(rotation) < 0 or (matrix[3] != (0, 0, 0, 1)).any():
        raise ValueError("a view_matrix that is not a rotation and a translation")
    u, _, vt = np.linalg.svd(rotation)
    viewmat[:3, :3] = u @ vt
    return viewmat
