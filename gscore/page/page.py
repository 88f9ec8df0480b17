"""Page writer: an HTML template filled with splats, cameras and photos."""

import html
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..io.files import atomic_write
from . import ascii85
from .pack import Packed

_SCRIPTS = ("unpack.js", "draw.js", "eye.js", "hands.js", "view.js")
"""In the order in which they build on each other."""
_PLACE = re.compile("@([a-z]+)@")
_TEXELS = 2048 * 16384
"""Of a texture as draw.js makes it, at the height that most graphics cards take."""


@dataclass(frozen=True, kw_only=True)
class PageCamera:
    """A view that can be chosen, or begun with."""

    name: str
    label: str
    """As the list shows it."""
    viewmat: np.ndarray
    """[4, 4] float64, world to camera, OpenCV axes."""
    K: np.ndarray
    """[3, 3] float64, pixels."""
    width: int
    """px."""
    height: int
    """px."""
    photo: str = ""
    """`data:image/jpeg;base64,...`; empty: none is shown."""


@dataclass(frozen=True, kw_only=True)
class Page:
    """Contents of a page."""

    title: str
    splats: Packed
    cameras: Sequence[PageCamera]
    first: PageCamera
    """What is seen at first; one of `cameras` or another."""
    focus: np.ndarray
    """[3], world units: what the view turns about at first."""
    up: np.ndarray
    """[3], world direction."""
    background: tuple[float, float, float]
    """Behind the splats."""
    near: float
    """Splats with z at or below this are not drawn; world units."""
    antialias: bool
    """Whether opacities are compensated for the low-pass."""
    facts: str
    """A line on what is shown."""


def most_splats(degree: int) -> int:
    """Splats of an SH degree that the texture of a page holds, by the texels that unpack.js gives
    each: two, and one for every sixteen higher coefficients."""
    return _TEXELS // (2 + -(-3 * ((degree + 1) ** 2 - 1) // 16))


def write_page(path: Path, page: Page) -> int:
    """Write the file completely or not at all; returns its size in bytes.

    Raises:
        GsError: it cannot be written.
    """
    content = page_html(page).encode("utf-8", "backslashreplace")
    atomic_write(path, content)
    return len(content)


def page_html(page: Page) -> str:
    """The text of the file."""
    parts = {
        "title": html.escape(page.title),
        "style": _asset("view.css"),
        "scene": _as_script(_scene(page)),
        "splats": ascii85.encode(page.splats.body),
        "vertex": _asset("splat.vert"),
        "fragment": _asset("splat.frag"),
        "sorter": _asset("sort.js"),
        "script": '"use strict";\n' + "\n".join(_asset(name) for name in _SCRIPTS),
    }
    return _PLACE.sub(lambda match: parts[match[1]], _asset("view.html"))


def _asset(name: str) -> str:
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


def _as_script(content: Any) -> str:
    """JSON that cannot close the HTML element around it."""
    return json.dumps(content, allow_nan=False).replace("<", "\\u003c")


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
