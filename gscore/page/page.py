"""Page writer: an HTML template filled with splats, cameras and photos."""

import html
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..glsl import glsl_defines
from ..io.files import atomic_write
from .pack import Packed, ascii85

_SCRIPTS = ("unpack.js", "draw.js", "eye.js", "hands.js", "view.js")
"""Scripts of the page, each after those it depends on."""
_PLACE = re.compile("@([a-z]+)@")
_TEXELS = 2048 * 16384
"""Texels of the texture of draw.js, at the maximum height of most graphics cards."""


@dataclass(frozen=True, kw_only=True)
class PageCamera:
    """A view of the page."""

    name: str
    label: str
    """Text in the list."""
    viewmat: np.ndarray
    """[4, 4] float64, world to camera, OpenCV axes."""
    K: np.ndarray
    """[3, 3] float64, pixels."""
    width: int
    """Width, px."""
    height: int
    """Height, px."""
    photo: str = ""
    """`data:image/jpeg;base64,...`; empty: none."""


@dataclass(frozen=True, kw_only=True)
class Page:
    """Contents of a page."""

    title: str
    splats: Packed
    cameras: Sequence[PageCamera]
    first: PageCamera
    """Initial view; one of `cameras` or another."""
    focus: np.ndarray
    """[3], world units, initial centre of rotation."""
    up: np.ndarray
    """[3], world direction."""
    background: tuple[float, float, float]
    """Background colour."""
    near: float
    """Splats with z at or below this are not drawn; world units."""
    antialias: bool
    """Opacity compensation of the low-pass filter."""
    facts: str
    """A line on the content."""


def most_splats(degree: int) -> int:
    """Maximum number of splats of an SH degree in the texture of a page. As in unpack.js, each has
    two texels, and one per sixteen higher coefficients."""
    return _TEXELS // (2 + -(-3 * ((degree + 1) ** 2 - 1) // 16))


def write_page(path: Path, page: Page) -> int:
    """Write the file completely or not at all; returns its size in bytes.

    Raises:
        GsError: the file cannot be written.
    """
    content = page_html(page).encode("utf-8", "backslashreplace")
    atomic_write(path, content)
    return len(content)


def page_html(page: Page) -> str:
    """The page as HTML."""
    parts = {  # JSON that cannot close the HTML element around it
        "title": html.escape(page.title),
        "style": _asset("view.css"),
        "scene": json.dumps(_scene(page), allow_nan=False).replace("<", "\\u003c"),
        "splats": ascii85(page.splats.body),
        "vertex": _shader("splat.vert"),
        "fragment": _shader("splat.frag"),
        "sorter": _asset("sort.js"),
        "script": '"use strict";\n' + "\n".join(_asset(name) for name in _SCRIPTS),
    }
    return _PLACE.sub(lambda match: parts[match[1]], _asset("view.html"))


def _asset(name: str) -> str:
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


def _shader(name: str) -> str:
    """A shader with the values of its macros after its first line, the version."""
    version, source = _asset(name).split("\n", 1)
    defines = (f"#define {macro} {value}\n" for macro, value in glsl_defines(source).items())
    return f"{version}\n{''.join(defines)}{source}"


def _scene(page: Page) -> dict[str, Any]:
    cameras = list(page.cameras)
    number = next((i for i, camera in enumerate(cameras) if camera is page.first), None)
    return {
        "splats": page.splats.head | {"bytes": len(page.splats.body)},
        "cameras": [_camera(camera) for camera in cameras],
        "first": {"number": number} | ({} if number is not None else _camera(page.first)),
        "focus": page.focus.tolist(),
        "up": page.up.tolist(),
        "background": list(page.background),
        "near": page.near,
        "antialias": page.antialias,
        "facts": page.facts,
    }


def _camera(camera: PageCamera) -> dict[str, Any]:
    rotation = camera.viewmat[:3, :3]
    return {
        "name": camera.name,
        "label": camera.label,
        "rotation": rotation.tolist(),
        "position": (-rotation.T @ camera.viewmat[:3, 3]).tolist(),
        "fx": float(camera.K[0, 0]),
        "fy": float(camera.K[1, 1]),
        "cx": float(camera.K[0, 2]),
        "cy": float(camera.K[1, 2]),
        "width": camera.width,
        "height": camera.height,
        "photo": camera.photo,
    }
