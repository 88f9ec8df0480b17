"""The JSON inside checkpoints, read and replaced in their bytes."""

import json
import struct
import zlib
from typing import Any


def _metadata(raw: bytes) -> tuple[dict[str, Any], int]:
    """Header of a safetensors file and where it ends."""
    end = 8 + struct.unpack("<Q", raw[:8])[0]
    return json.loads(raw[8:end]), end


def checkpoint_json(raw: bytes) -> bytes:
    """What a checkpoint states beside its tensors."""
    return _metadata(raw)[0]["__metadata__"]["gscore"].encode()


def with_checkpoint_json(raw: bytes, text: bytes) -> bytes:
    """The checkpoint `raw` that states `text` instead, with the checksum that belongs to it."""
    header, end = _metadata(raw)
    words = text.decode("utf-8", "replace")
    header["__metadata__"] = {"gscore": words, "crc32": str(zlib.crc32(words.encode()))}
    encoded = json.dumps(header).encode()
    encoded += b" " * (-len(encoded) % 8)
    return struct.pack("<Q", len(encoded)) + encoded + raw[end:]
