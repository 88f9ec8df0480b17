"""glTF 2.0 files: JSON and buffers, as .glb or .gltf, and the numbers of accessors.

Source: the specification of the Khronos Group. All offsets and sizes are checked against the bytes
of the file before use.
"""

import base64
import json
import os
import re
import string
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..errors import ConfigError, DatasetError, FormatError
from ..io.files import read_bytes
from ..json_text import parse_json
from ..quoting import quoted
from .axes import UP, UPRIGHT
from .parts import check_part

GLB_MAGIC = b"glTF"
CHECK = "crc32"
"""Key in the extras of a buffer: CRC-32 of its file, written with a .gltf."""
FLOAT, UNSIGNED_BYTE, UNSIGNED_INT = 5126, 5121, 5125
_STORED = {"u1": UNSIGNED_BYTE, "u4": UNSIGNED_INT}
"""Component types by dtype; others are written as FLOAT."""
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_HEADER = struct.Struct("<4sII")
_CHUNK = struct.Struct("<I4s")
_JSON, _BINARY = b"JSON", b"BIN\0"
_ADVICE = "Export it again."
_UNRESERVED = frozenset(string.ascii_letters + string.digits + "-._~")


class Gltf:
    """A glTF file: its JSON, and its buffers, read on request."""

    def __init__(self, path: Path) -> None:
        """Read the JSON.

        Raises:
            DatasetError: the file is missing.
            FormatError: it is not glTF 2.0, or damaged.
        """
        self.path = path
        raw = memoryview(read_bytes(path))
        self.bytes_read = len(raw)
        """Bytes of the file and of the buffer files read so far."""
        text, self._binary = raw, None
        if raw[:4] == GLB_MAGIC:
            text, self._binary = self._chunks(raw)
        try:
            content = parse_json(bytes(text))
        except (ValueError, UnicodeDecodeError) as error:
            raise self.damaged(f"its JSON cannot be read ({error})") from error
        if not isinstance(content, dict):
            raise self.damaged("its JSON is not an object")
        self.content: dict[str, Any] = content
        asset = content.get("asset")
        version = asset.get("version") if isinstance(asset, dict) else None
        if version != "2.0":
            raise FormatError(
                f"{path} is a glTF file of version {quoted(version)}; 2.0 is read. {_ADVICE}"
            )
        self._buffers: dict[int, memoryview] = {}

    def damaged(self, why: str) -> FormatError:
        """Error for invalid contents of the file."""
        return FormatError(f"{self.path} is a damaged glTF file: {why}. {_ADVICE}")

    def entry(self, kind: str, index: Any) -> dict[str, Any]:
        """The object with this index in one of the lists of the JSON."""
        listed = self.content.get(kind)
        found = None
        if isinstance(listed, list) and type(index) is int and 0 <= index < len(listed):
            found = listed[index]
        if not isinstance(found, dict):
            raise self.damaged(f"it has no {quoted(index)} among its {kind}")
        return found

    def listed(self, place: dict[str, Any], key: str) -> list[Any]:
        """A list of an object; empty if missing."""
        value = place.get(key, [])
        if not isinstance(value, list):
            raise self.damaged(f"{key} is not a list")
        return value

    def whole(self, place: dict[str, Any], key: str, default: int | None = None) -> int:
        """A whole number of at least 0 that an object has."""
        value = place.get(key, default)
        if type(value) is not int or value < 0:
            raise self.damaged(f"{key} is {quoted(value)}")
        return value

    def view(self, index: Any) -> memoryview:
        """Bytes of a bufferView."""
        view = self.entry("bufferViews", index)
        if "EXT_meshopt_compression" in as_object(view.get("extensions")):
            raise FormatError(
                f"{self.path} uses EXT_meshopt_compression, which is not supported. "
                f"Export it without compression, or with that of SPZ."
            )
        buffer = self._buffer(self.whole(view, "buffer"))
        start, size = self.whole(view, "byteOffset", 0), self.whole(view, "byteLength")
        if start + size > len(buffer):
            raise self.damaged(
                f"bufferView {index} ends at byte {start + size} of a buffer of {len(buffer)}"
            )
        return buffer[start : start + size]

    def numbers(self, index: Any, kind: str) -> np.ndarray:
        """[N, width] float32 of an accessor of type `kind`, scaled if it is normalized."""
        accessor = self.entry("accessors", index)
        stored = accessor.get("componentType")
        dtype = np.dtype(_TYPES[stored]) if type(stored) is int and stored in _TYPES else None
        if dtype is None or accessor.get("type") != kind:
            raise self.damaged(
                f"accessor {index} contains {quoted(accessor.get('type'))} of {quoted(stored)}, "
                f"expected {kind}"
            )
        if "sparse" in accessor or "bufferView" not in accessor:
            raise FormatError(
                f"{self.path}: accessor {index} is sparse or has no bufferView, which is not "
                f"supported. {_ADVICE}"
            )
        count, width = self.whole(accessor, "count"), _WIDTHS[kind]
        data, start = self.view(accessor["bufferView"]), self.whole(accessor, "byteOffset", 0)
        row = width * dtype.itemsize
        stride = self.whole(self.entry("bufferViews", accessor["bufferView"]), "byteStride", row)
        stride = stride or row
        if stride < row or (count and start + (count - 1) * stride + row > len(data)):
            raise self.damaged(f"accessor {index} of {count} rows goes on beyond its bufferView")
        if not count:
            return np.zeros((0, width), np.float32)
        raw = np.ndarray((count, width), dtype, data, start, (stride, dtype.itemsize))
        values = raw.astype(np.float32)
        if accessor.get("normalized") is True and dtype.kind in "iu":
            values = np.maximum(values / np.float32(np.iinfo(dtype).max), -1)
        return values

    def _chunks(self, raw: memoryview) -> tuple[memoryview, memoryview | None]:
        """JSON and binary chunk of a .glb."""
        if len(raw) < _HEADER.size + _CHUNK.size:
            raise self.damaged("its header is truncated")
        _, version, length = _HEADER.unpack_from(raw)
        if version != 2:
            raise FormatError(f"{self.path} is a .glb of version {version}; 2 is read. {_ADVICE}")
        if length > len(raw):
            raise self.damaged(f"its header states {length} bytes, it has {len(raw)}")
        found: dict[bytes, memoryview] = {}
        at = _HEADER.size
        while at + _CHUNK.size <= length and len(found) < 2:
            size, kind = _CHUNK.unpack_from(raw, at)
            at += _CHUNK.size
            if at + size > len(raw):
                raise self.damaged(f"a chunk states {size} bytes, {len(raw) - at} are left")
            found.setdefault(kind, raw[at : at + size])
            at += size
        if _JSON not in found:
            raise self.damaged("it has no JSON")
        return found[_JSON], found.get(_BINARY)

    def _buffer(self, index: int) -> memoryview:
        if index not in self._buffers:
            buffer = self.entry("buffers", index)
            check = as_object(buffer.get("extras")).get(CHECK)
            self._buffers[index] = self._load(index, buffer.get("uri"), check)
        return self._buffers[index]

    def _load(self, index: int, uri: Any, check: Any) -> memoryview:
        if uri is None and index == 0 and self._binary is not None:
            return self._binary
        if not isinstance(uri, str):
            raise self.damaged(f"buffer {index} has no bytes")
        if uri.startswith("data:"):
            try:
                return memoryview(base64.b64decode(uri.partition(",")[2], validate=True))
            except ValueError as error:
                raise self.damaged(f"buffer {index} is not base64 ({error})") from error
        name = _unescaped(uri)
        if Path(name).name != name or "\\" in name or ":" in name or name in ("", ".", ".."):
            raise self.damaged(f"buffer {index} names the file {quoted(uri)}, outside its folder")
        try:
            found = memoryview(read_bytes(self.path.parent / name))
        except DatasetError as error:
            raise DatasetError(f"{self.path} needs {quoted(name)} next to it. {error}") from error
        check_part(self.path, name, found, check)
        self.bytes_read += len(found)
        return found


class GltfBuffer:
    """A buffer written in pieces, with its accessors and bufferViews."""

    def __init__(self) -> None:
        self.accessors: list[dict[str, Any]] = []
        self.views: list[dict[str, Any]] = []
        self.size = 0
        self._chunks: list[np.ndarray | bytes] = []

    def add_bytes(self, raw: bytes) -> int:
        """Add bytes; returns the index of their bufferView."""
        return self._add(raw, len(raw))

    def add(self, array: np.ndarray, kind: str, **more: Any) -> int:
        """Add rows, which are copied when the file is written; returns the index of their accessor.

        Args:
            array: [N, width] or [N], float32, uint8 or uint32.
            kind: Its type in glTF.
            more: Further properties of the accessor.
        """
        stored = _STORED.get(array.dtype.str[1:], FLOAT)
        self.accessors.append(
            {
                "bufferView": self._add(array, array.nbytes),
                "componentType": stored,
                "count": len(array),
                "type": kind,
                **more,
            }
        )
        return len(self.accessors) - 1

    def write_to(self, file: BinaryIO) -> None:
        """Write all pieces, each padded to four bytes."""
        for piece in self._chunks:
            raw = piece if isinstance(piece, bytes) else np.ascontiguousarray(piece).data
            file.write(raw)
            size = len(raw) if isinstance(raw, bytes) else raw.nbytes
            file.write(bytes(-size % 4))

    def _add(self, piece: np.ndarray | bytes, size: int) -> int:
        self.views.append({"buffer": 0, "byteOffset": self.size, "byteLength": size})
        self._chunks.append(piece)
        self.size += size + -size % 4
        return len(self.views) - 1


TO_GLTF = np.array([-1.0, -1, 1])
"""Signs of positions between right-down-front, as of splats, and glTF's left-up-front."""


def upright_node(up: str, place: np.ndarray | None = None) -> dict[str, Any]:
    """Properties of a node whose numbers are in left-up-front, so that y is up in the file.

    Args:
        up: Up axis of the splats' world, X to -Z; empty: as -Y.
        place: [3], position of the node in the splats' world; None: its origin.
    """
    node: dict[str, Any] = {}
    if up in UPRIGHT and up != "-Y":
        node = {"rotation": list(UPRIGHT[up]), "extras": {UP: up}}
    if place is not None:
        turn = node_matrix(UPRIGHT.get(up, UPRIGHT["-Y"]))
        node["translation"] = (turn @ (place * TO_GLTF)).tolist()
    return node


def node_matrix(rotation: Sequence[float] | np.ndarray) -> np.ndarray:
    """Rotation [3, 3] of a quaternion of a node, xyzw, for column vectors."""
    x, y, z, w = rotation
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def write_glb(file: BinaryIO, content: dict[str, Any], buffer: GltfBuffer) -> None:
    """Write a .glb with JSON and one buffer.

    Raises:
        ConfigError: it would be larger than a .glb can be.
    """
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    length = _HEADER.size + 2 * _CHUNK.size + len(text) + buffer.size
    if length >= 2**32:
        raise ConfigError("A .glb has 4 GiB at most; write a .gltf, or one with SPZ (.spz.glb).")
    file.write(_HEADER.pack(GLB_MAGIC, 2, length))
    file.write(_CHUNK.pack(len(text), _JSON) + text)
    file.write(_CHUNK.pack(buffer.size, _BINARY))
    buffer.write_to(file)


def escaped(name: str) -> str:
    """File name as a URI (RFC 3986), with percent-encoded UTF-8."""
    return "".join(
        chr(byte) if chr(byte) in _UNRESERVED else f"%{byte:02X}" for byte in os.fsencode(name)
    )


def buffers_in(content: dict[str, Any]) -> list[str]:
    """Buffer files in the JSON of a .gltf."""
    uris = [buffer["uri"] for buffer in content["buffers"] if "uri" in buffer]
    return [_unescaped(uri) for uri in uris if not uri.startswith("data:")]


def _unescaped(uri: str) -> str:
    raw = re.sub(
        rb"%([0-9A-Fa-f]{2})",
        lambda found: bytes([int(found[1], 16)]),
        uri.encode("utf-8", "replace"),
    )
    return os.fsdecode(raw)


def as_object(value: Any) -> dict[str, Any]:
    """`value` if it is a JSON object, else an empty one."""
    return value if isinstance(value, dict) else {}
