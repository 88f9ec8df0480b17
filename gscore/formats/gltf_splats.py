"""glTF splat reader: KHR_gaussian_splatting, plain or packed as SPZ.

Source: the extensions' texts in github.com/KhronosGroup/glTF. Sizes are linear and opacities from 0
to 1; drafts had log scales, which are detected by negative values. Axes are left-up-front.
"""

from collections.abc import Container, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError, ShapeError
from ..io.file_sample import FileSample
from ..io.ply.comments import UP_AXIS
from ..io.splat_rows import drawable, log_scales, logits
from ..quoting import quoted
from ..sh import rgb_to_sh0
from ..splats import SH_REST_BY_DEGREE, Splats
from ..text_format import number
from ..transforms import transform_splats
from . import spz
from .axes import UP, UPRIGHT, X, Z, half_turn
from .gltf import GLB_MAGIC, Gltf, as_object, node_matrix
from .gltf_writing import (
    EXTENSION,
    GLTF_MARK,
    PACKED,
    POINTS_MODE,
    buffer_of,
    harmonic,
    write_gltf,
    write_packed_gltf,
)
from .joined import joined_files
from .splat_file import Decoded, SplatFormat, origin_in

_DRAFTS = ("KHR_spz_gaussian_splats_compression", "KHR_spz_compression")
"""SPZ extensions of Cesium before July 2025 and of the first draft, directly in the primitive."""
_RETILE = "Tile or export it again with a newer version of the program that wrote it, or as a PLY."
_HARMLESS = ("KHR_materials_", "KHR_texture_", "KHR_mesh_quantization", "KHR_lights_")
"""Prefixes of required extensions that do not affect splats."""
_MOST_DEPTH = 256
_MOST_SPLATS_A_BYTE, _SLACK = 1, 1 << 16
"""Most splats per byte of a file with several nodes of splats, and the slack. A splat takes 30
bytes as numbers and about ten in SPZ."""
_DIGITS = 12
"""Digits of a rotation without its rounding errors."""
_TURNED = 1e-5
"""Largest difference of a rotation, by its matrix, from that of the writer."""
_NEAR_BOUNDS = 0.05
"""Largest distance of positions from their stated bounds, as a share of the largest bound."""


def _is_gltf(path: Path, sample: FileSample) -> bool:
    if sample.head.startswith(GLB_MAGIC):
        return True
    is_text = b"\0" not in sample.head and sample.head.lstrip(b"\xef\xbb\xbf \r\n\t")[:1] == b"{"
    named = sample.ending == ".gltf" and b'"asset"' in sample.head + sample.tail
    return is_text and (named or EXTENSION.encode() in sample.head + sample.tail)


def _read(path: Path) -> Decoded:
    file = Gltf(path)
    _check_required(file)
    parts, layouts, marks, origins = [], [], [], []
    count = 0
    found = list(_primitives(file))
    ups = {up for _, up, _ in found}
    up = ups.pop() if len(ups) == 1 else ""
    for matrix, _, primitive in found:
        splats, layout, flagged = _splats(file, primitive)
        count += len(splats)
        _check_repeated(file, count, len(parts) + 1)
        parts.append(half_turn(_placed(file, splats, _in_own_world(up, matrix)), Z))
        layouts.append(layout)
        extras = as_object(primitive.get("extras"))
        marks.append(flagged or extras.get(GLTF_MARK) is True)
        origins.append(origin_in(extras, file.damaged))
    if not parts:
        meshes = len(file.listed(file.content, "meshes"))
        raise FormatError(
            f"{path} is a glTF file without splats: none of its {meshes} meshes has the extension "
            f"{EXTENSION}. Give the file of a trained model."
        )
    facts: dict[str, Any] = {"layout": layouts[0], "antialiased": all(marks)}
    if up:
        facts["comments"] = (f"{UP_AXIS}{up}",)
    pairs = zip(parts, origins, strict=True)
    return joined_files([Decoded(splats=part, origin=origin, **facts) for part, origin in pairs])


def _check_repeated(file: Gltf, count: int, times: int) -> None:
    """Raise FormatError if the same bytes are used for too many splats: one mesh in many nodes, or
    one accessor in many meshes."""
    if times > 1 and count > _MOST_SPLATS_A_BYTE * file.bytes_read + _SLACK:
        raise FormatError(
            f"{file.path} repeats its splats: {number(times)} nodes have {number(count)} of them "
            f"and more, from {number(file.bytes_read)} bytes. Export it with each splat "
            f"once, or as a 3DGS PLY."
        )


def _check_drafts(file: Gltf, names: Container[Any]) -> None:
    """Raise FormatError if one of the names is an extension from before the final `EXTENSION`."""
    for name in _DRAFTS:
        if name in names:
            raise FormatError(
                f"{file.path} packs its splats with {name}, a draft of 2025 that "
                f"{PACKED[0]} replaced, and is not read. {_RETILE}"
            )


def _check_required(file: Gltf) -> None:
    known = (EXTENSION, *PACKED)
    required = file.listed(file.content, "extensionsRequired")
    _check_drafts(file, required)
    strange = [
        name
        for name in required
        if name not in known and not (isinstance(name, str) and name.startswith(_HARMLESS))
    ]
    if strange:
        raise FormatError(
            f"{file.path} needs extensions of glTF that are not read: "
            f"{', '.join(quoted(name) for name in strange)}. Export it without them."
        )


def _primitives(file: Gltf) -> Iterator[tuple[np.ndarray, str, dict[str, Any]]]:
    """Matrices [4, 4], up axes and primitives of splats, of the scene's nodes, or of all meshes
    without a scene."""
    scenes = file.listed(file.content, "scenes")
    if not scenes:
        for index in range(len(file.listed(file.content, "meshes"))):
            yield from ((np.eye(4), "", found) for found in _of_mesh(file, index))
        return
    scene = file.entry("scenes", file.content.get("scene", 0))
    left = [(node, np.eye(4), 0) for node in file.listed(scene, "nodes")]
    visited = set()
    while left:
        index, above, depth = left.pop()
        node = file.entry("nodes", index)
        if index in visited or depth > _MOST_DEPTH:
            raise file.damaged(f"node {index} is the child of two nodes")
        visited.add(index)
        matrix = above @ _matrix(file, node)
        if "mesh" in node:
            up = _up_of(file, node)
            yield from ((matrix, up, found) for found in _of_mesh(file, node["mesh"]))
        left += [(child, matrix, depth + 1) for child in file.listed(node, "children")]


def _of_mesh(file: Gltf, index: Any) -> Iterator[dict[str, Any]]:
    for primitive in file.listed(file.entry("meshes", index), "primitives"):
        extensions = as_object(as_object(primitive).get("extensions"))
        _check_drafts(file, extensions)
        if EXTENSION in extensions:
            if primitive.get("mode", 4) != POINTS_MODE:
                raise file.damaged(f"mesh {index} has splats whose mode is not POINTS")
            yield primitive


def _matrix(file: Gltf, node: dict[str, Any]) -> np.ndarray:
    """Matrix [4, 4] of a node, for column vectors."""
    if "matrix" in node:
        return _numbers(file, node, "matrix", np.eye(4).ravel()).reshape(4, 4).T
    turn = node_matrix(_numbers(file, node, "rotation", np.array([0.0, 0, 0, 1])))
    out = np.eye(4)
    out[:3, :3] = turn * _numbers(file, node, "scale", np.ones(3))
    out[:3, 3] = _numbers(file, node, "translation", np.zeros(3))
    return out


def _up_of(file: Gltf, node: dict[str, Any]) -> str:
    """The up axis by which the writer turned a node; empty: none, or other programs have used the
    key in their own sense, or changed the rotation."""
    up = as_object(node.get("extras")).get(UP)
    if not isinstance(up, str) or up not in UPRIGHT:
        return ""
    is_ours = np.allclose(_matrix(file, node)[:3, :3], node_matrix(UPRIGHT[up]), atol=_TURNED)
    return up if is_ours else ""


def _in_own_world(up: str, matrix: np.ndarray) -> np.ndarray:
    """A matrix [4, 4] without the rotation by which the writer turned a world upright, undone after
    all that other programs add."""
    if not up:
        return matrix
    back = np.eye(4)
    back[:3, :3] = node_matrix(UPRIGHT[up]).T
    own = back @ matrix
    own[:3, :3] = np.round(own[:3, :3], _DIGITS)
    return own


def _numbers(file: Gltf, node: dict[str, Any], key: str, default: np.ndarray) -> np.ndarray:
    values = node.get(key)
    if values is None:
        return default
    fine = isinstance(values, list) and len(values) == len(default)
    if not fine or not all(type(v) in (int, float) and abs(v) < 1e30 for v in values):
        raise file.damaged(f"{key} of a node is {quoted(values)}")
    return np.array(values, np.float64)


def _placed(file: Gltf, splats: Splats, matrix: np.ndarray) -> Splats:
    if np.array_equal(matrix, np.eye(4)):
        return splats
    try:
        return transform_splats(splats, matrix)
    except ShapeError as error:
        raise FormatError(
            f"{file.path}: a node cannot be applied to its splats. {error}"
        ) from error


def _splats(file: Gltf, primitive: dict[str, Any]) -> tuple[Splats, str, bool]:
    """Splats of a primitive in glTF's axes, the name of the layout, and whether the compressed data
    mark them as antialiased."""
    extension = as_object(primitive["extensions"][EXTENSION])
    inner = as_object(extension.get("extensions"))
    for name in PACKED:
        if name in inner:
            raw = file.view(as_object(inner[name]).get("bufferView"))
            try:
                found = spz.decode_spz(file.path, raw)
            except FormatError as error:
                raise FormatError(f"The SPZ within a glTF file: {error}") from error
            is_stored = _is_as_stored(file, primitive, found.splats)
            turned = half_turn(found.splats, X if is_stored else Z)
            layout = f"glTF with {found.layout}{', axes as stored' if is_stored else ''}"
            return turned, layout, found.antialiased
    if inner:
        raise FormatError(
            f"{file.path} packs its splats with {', '.join(map(quoted, inner))}, which is not "
            f"read; {' and '.join(PACKED)} are. Export it without compression."
        )
    _check_kind(file, extension)
    return _plain(file, as_object(primitive.get("attributes"))), "glTF", False


def _is_as_stored(file: Gltf, primitive: dict[str, Any], splats: Splats) -> bool:
    """True if the numbers of an SPZ are in glTF's axes as stored, as in tiles of Cesium: the stated
    bounds match the stored positions, not those rotated from right-up-back to left-up-front.
    `splats` are in the axes of a 3DGS PLY."""
    accessor = file.entry("accessors", as_object(primitive.get("attributes")).get("POSITION"))
    ends = [accessor.get(key) for key in ("min", "max")]
    if not len(splats) or not all(
        isinstance(end, list) and len(end) == 3 and all(type(v) in (int, float) for v in end)
        for end in ends
    ):
        return False
    stated = np.array(ends, np.float64)
    corners = np.stack([splats.means.min(axis=0), splats.means.max(axis=0)]).astype(np.float64)
    stored, turned = (
        float(np.abs(np.sort(corners * signs, axis=0) - stated).max())
        for signs in ([1, -1, -1], [-1, -1, 1])
    )
    return stored <= _NEAR_BOUNDS * np.abs(stated).max() and turned > 4 * stored


def _check_kind(file: Gltf, extension: dict[str, Any]) -> None:
    kernel = extension.get("kernel", "ellipse")
    color = extension.get("colorSpace", "srgb_rec709_display")
    if kernel != "ellipse":
        raise FormatError(
            f"{file.path} has splats of the kernel {quoted(kernel)}; ellipse is supported. {_AGAIN}"
        )
    if color != "srgb_rec709_display":
        raise FormatError(
            f"{file.path} has splats in the colour space {quoted(color)}; srgb_rec709_display is "
            f"supported. {_AGAIN}"
        )


_AGAIN = "Export it in that, or as a 3DGS PLY."


def _plain(file: Gltf, attributes: dict[str, Any]) -> Splats:
    """Splats from accessors."""
    _check_attributes(file, attributes)
    means = file.numbers(attributes.get("POSITION"), "VEC3")
    quats = file.numbers(attributes.get(f"{EXTENSION}:ROTATION"), "VEC4")
    scales = file.numbers(attributes.get(f"{EXTENSION}:SCALE"), "VEC3")
    opacities = file.numbers(attributes.get(f"{EXTENSION}:OPACITY"), "SCALAR")[:, 0]
    base = attributes.get(f"{EXTENSION}:SH_DEGREE_0_COEF_0")
    if base is None and "COLOR_0" in attributes:
        kind = file.entry("accessors", attributes["COLOR_0"]).get("type")
        colors = file.numbers(attributes["COLOR_0"], "VEC4" if kind == "VEC4" else "VEC3")
        sh0 = rgb_to_sh0(colors[:, :3]).astype(np.float32)
    else:
        sh0 = file.numbers(base, "VEC3")
    shN = _harmonics(file, attributes, len(means))
    if len({len(a) for a in (means, quats, scales, opacities, sh0, shN)}) != 1:
        raise file.damaged("the attributes of its splats have different numbers of rows")
    is_log = bool((scales < 0).any())
    return drawable(
        file.path,
        means=means,
        quats=quats[:, [3, 0, 1, 2]],
        scales=scales if is_log else log_scales(scales),
        opacities=logits(opacities),
        sh0=sh0,
        shN=shN,
    )


def _check_attributes(file: Gltf, attributes: dict[str, Any]) -> None:
    """Raise FormatError for missing attributes, or those of drafts of the extension."""
    if "_ROTATION" in attributes or "_SCALE" in attributes:
        raise FormatError(
            f"{file.path} has splats of a draft of {EXTENSION} of early 2025, with the attributes "
            f"_ROTATION and _SCALE, which is not read. {_RETILE}"
        )
    needed = ["POSITION", *(f"{EXTENSION}:{name}" for name in ("ROTATION", "SCALE", "OPACITY"))]
    missing = [name for name in needed if name not in attributes]
    if f"{EXTENSION}:SH_DEGREE_0_COEF_0" not in attributes and "COLOR_0" not in attributes:
        missing.append(f"{EXTENSION}:SH_DEGREE_0_COEF_0")
    if missing:
        raise file.damaged(f"its splats lack {', '.join(missing)}")


def _harmonics(file: Gltf, attributes: dict[str, Any], count: int) -> np.ndarray:
    """[N, K-1, 3] of the complete bands."""
    names = [harmonic(degree, index) for degree in (1, 2, 3) for index in range(2 * degree + 1)]
    there = next((k for k, name in enumerate(names) if name not in attributes), len(names))
    width = max(w for w in SH_REST_BY_DEGREE.values() if w <= there)
    out = np.empty((count, width, 3), np.float32)
    for k in range(width):
        values = file.numbers(attributes[names[k]], "VEC3")
        if len(values) != count:
            raise file.damaged(f"{names[k]} has {len(values)} rows, expected {count}")
        out[:, k] = values
    return out


GLTF = SplatFormat(
    key="gltf",
    name="glTF",
    endings=(".glb", ".gltf"),
    recognizes=_is_gltf,
    read=_read,
    write=write_gltf,
    part_files=buffer_of,
    keeps_proxy=True,
)
GLTF_SPZ = SplatFormat(
    key="gltf-spz",
    name="glTF with SPZ",
    endings=(".spz.glb", ".spz.gltf"),
    recognizes=lambda path, sample: False,  # `GLTF` reads both
    read=_read,
    write=write_packed_gltf,
    part_files=buffer_of,
    keeps_proxy=True,
)
