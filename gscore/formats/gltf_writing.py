"""glTF splat writer: KHR_gaussian_splatting, plain or packed as SPZ, and its property names.

Source: see gltf_splats.py.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from .._version import __version__
from ..io.files import atomic_write
from ..io.ply.comments import stated_up
from ..io.splat_rows import linear_scales, opacities_of
from ..sh import sh0_to_rgb
from ..splats import Splats
from ..transforms import unit_quats
from . import spz
from .axes import Z, half_turn
from .gltf import CHECK, TO_GLTF, GltfBuffer, buffers_in, escaped, upright_node, write_glb
from .parts import parts_of, write_parts
from .splat_file import ORIGIN, WriteOptions

EXTENSION = "KHR_gaussian_splatting"
PACKED = (f"{EXTENSION}_compression_spz_2", f"{EXTENSION}_compression_spz")
POINTS_MODE = 0
"""Mode of primitives."""
_PROPERTIES = {
    "kernel": "ellipse",
    "colorSpace": "srgb_rec709_display",
    "projection": "perspective",
    "sortingMethod": "cameraDistance",
}
GLTF_MARK = "antialiased"
"""Key in the extras of a primitive, because the extension has none for it."""
_HIDDEN = "KHR_node_visibility"
PROXY = "proxy"
"""Name of the node of a proxy, and key in its extras."""


def harmonic(degree: int, index: int) -> str:
    """Attribute name of a SH coefficient."""
    return f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{index}"


def write_gltf(path: Path, splats: Splats, options: WriteOptions) -> list[str]:
    """Write a file with all parameters as float32."""
    buffer = GltfBuffer()
    content = _content(_attributes(buffer, half_turn(splats, Z)), {}, options, buffer)
    _write_file(path, content, buffer)
    return []


def write_packed_gltf(path: Path, splats: Splats, options: WriteOptions) -> list[str]:
    """Write a file with the splats as SPZ."""
    buffer = GltfBuffer()
    raw, notes, means = spz.encode_spz(splats, antialiased=options.antialiased, version=3)
    name = PACKED[0]
    packed = {"extensions": {name: {"bufferView": buffer.add_bytes(raw)}}}
    kinds = [
        ("POSITION", "VEC3"),
        (f"{EXTENSION}:ROTATION", "VEC4"),
        (f"{EXTENSION}:SCALE", "VEC3"),
    ]
    kinds += [(f"{EXTENSION}:OPACITY", "SCALAR"), (f"{EXTENSION}:SH_DEGREE_0_COEF_0", "VEC3")]
    kinds += [
        (harmonic(degree, index), "VEC3")
        for degree in range(1, splats.sh_degree + 1)
        for index in range(2 * degree + 1)
    ]
    attributes = {}
    for attribute, kind in kinds:  # without bufferViews: the data are in the SPZ
        attributes[attribute] = len(buffer.accessors)
        buffer.accessors.append({"componentType": 5126, "count": len(splats), "type": kind})
    buffer.accessors[0] |= _bounds(means * TO_GLTF.astype(np.float32))
    content = _content(attributes, packed, options, buffer)
    content["extensionsUsed"].append(name)
    content["extensionsRequired"] = [EXTENSION, name]
    _write_file(path, content, buffer)
    return notes


@np.errstate(over="ignore")  # colours beyond the range are clipped
def _attributes(buffer: GltfBuffer, splats: Splats) -> dict[str, int]:
    """Accessors of all parameters, for splats in the axes of glTF."""
    opacities = opacities_of(splats.opacities)
    colors = np.empty((len(splats), 4), np.uint8)
    colors[:, :3] = np.clip(np.rint(sh0_to_rgb(splats.sh0[:, 0]) * 255), 0, 255)
    colors[:, 3] = np.rint(opacities * 255)
    unit = unit_quats(splats.quats)
    out = {
        "POSITION": buffer.add(splats.means, "VEC3", **_bounds(splats.means)),
        "COLOR_0": buffer.add(colors, "VEC4", normalized=True),
        f"{EXTENSION}:ROTATION": buffer.add(unit[:, [1, 2, 3, 0]], "VEC4"),
        f"{EXTENSION}:SCALE": buffer.add(linear_scales(splats.scales), "VEC3"),
        f"{EXTENSION}:OPACITY": buffer.add(opacities, "SCALAR"),
        f"{EXTENSION}:SH_DEGREE_0_COEF_0": buffer.add(splats.sh0[:, 0], "VEC3"),
    }
    at = 0
    for degree in range(1, splats.sh_degree + 1):
        for index in range(2 * degree + 1):
            out[harmonic(degree, index)] = buffer.add(splats.shN[:, at], "VEC3")
            at += 1
    return out


def _bounds(means: np.ndarray) -> dict[str, list[float]]:
    if not len(means):
        return {}
    return {"min": means.min(axis=0).tolist(), "max": means.max(axis=0).tolist()}


def _content(
    attributes: dict[str, int],
    packed: dict[str, Any],
    options: WriteOptions,
    buffer: GltfBuffer,
) -> dict[str, Any]:
    """JSON of a file with one node, and a hidden one for a proxy, without the URI of its buffer."""
    primitive: dict[str, Any] = {
        "attributes": attributes,
        "mode": POINTS_MODE,
        "extensions": {EXTENSION: {**_PROPERTIES, **packed}},
    }
    extras: dict[str, Any] = {GLTF_MARK: True} if options.antialiased else {}
    extras |= {} if options.origin is None else {ORIGIN: options.origin.tolist()}
    if extras:
        primitive["extras"] = extras
    placed = upright_node(stated_up(options.comments))
    nodes: list[dict[str, Any]] = [{"mesh": 0, **placed}]
    meshes, used = [{"primitives": [primitive]}], [EXTENSION]
    if options.proxy is not None:
        meshes.append({"primitives": [_proxy(options, buffer)]})
        hidden = {
            "mesh": 1,
            "name": PROXY,
            "extras": {PROXY: True, **placed.get("extras", {})},
            "extensions": {_HIDDEN: {"visible": False}},
        }
        nodes.append({**placed, **hidden})
        used.append(_HIDDEN)
    return {
        "asset": {"version": "2.0", "generator": f"gscore {__version__}"},
        "extensionsUsed": used,
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": nodes,
        "meshes": meshes,
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": buffer.size}],
    }


def _proxy(options: WriteOptions, buffer: GltfBuffer) -> dict[str, Any]:
    """Primitive of the proxy, in the world of the splats."""
    assert options.proxy is not None
    places = (options.proxy_vertices * TO_GLTF).astype(np.float32)
    corners = np.ascontiguousarray(options.proxy.triangles, np.uint32).ravel()
    position = buffer.add(places, "VEC3", **_bounds(places))
    return {"attributes": {"POSITION": position}, "indices": buffer.add(corners, "SCALAR")}


def _write_file(path: Path, content: dict[str, Any], buffer: GltfBuffer) -> None:
    if path.suffix.lower() == ".glb":
        atomic_write(path, lambda file: write_glb(file, content, buffer))
        return
    part = path.with_suffix(".bin").name

    def text_of(names: dict[str, str], checks: dict[str, int]) -> bytes:
        extras = {CHECK: checks[part]}
        content["buffers"][0] |= {"uri": escaped(names[part]), "extras": extras}
        return json.dumps(content).encode()

    write_parts(path, {part: buffer.write_to}, text_of, buffers_in)


def buffer_of(path: Path) -> tuple[Path, ...]:
    """Buffer files of a .gltf, or the default one for a new .gltf."""
    if path.suffix.lower() == ".glb":
        return ()
    return parts_of(path, buffers_in) or (path.with_suffix(".bin"),)
