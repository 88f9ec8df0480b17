"""Names, pictures and depth maps of rendered stills."""

import struct
import zlib
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

import numpy as np

from ..io.files import atomic_write, is_unnameable
from ..raster.api import Rendered


def still_names(names: Sequence[str]) -> list[str]:
    """A relative path without ending for each view, unique, whatever the capture calls them.

    Sub-folders stay; what would lead out of the output folder is dropped; names that differ in
    their ending only keep it.
    """
    stems = [_inside(str(PurePosixPath(n).with_suffix("")) if n else "view") for n in names]
    whole = [_inside(n.replace(".", "_")) for n in names]
    result: list[str] = []
    for i, stem in enumerate(stems):
        wanted = stem if stems.count(stem) == 1 else whole[i]
        result.append(wanted if wanted not in result else f"{wanted}_{i}")
    return result


def _inside(name: str) -> str:
    parts = [p for p in name.replace("\\", "/").split("/") if p not in ("", ".", "..")]
    cleaned = ["".join("_" if _is_odd(c) else c for c in p) for p in parts]
    return "/".join(cleaned) or "view"


def _is_odd(letter: str) -> bool:
    """Whether some system takes the letter in no file name."""
    return letter in '<>:"|?*' or is_unnameable(letter)


def to_rgb(rendered: Rendered) -> np.ndarray:
    """[H, W, 3] uint8 of the picture over its background."""
    return (np.clip(rendered.rgb, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def to_rgba(rendered: Rendered) -> np.ndarray:
    """[H, W, 4] uint8 with straight alpha, of a picture rendered over black.

    Over black the colours are multiplied by alpha; PNG stores them undone.
    """
    alpha = rendered.alpha[..., None]
    color = np.divide(rendered.rgb, alpha, out=np.zeros_like(rendered.rgb), where=alpha > 1e-4)
    both = np.concatenate([color, alpha], axis=2)
    return (np.clip(both, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def write_depth_npy(path: Path, depth: np.ndarray) -> None:
    """Write [H, W] float32 depths exactly, in world units; 0 where nothing is."""
    atomic_write(path, lambda file: np.save(file, depth.astype(np.float32)))


def write_depth_png(path: Path, depth: np.ndarray, unit: float) -> None:
    """Write depths as 16-bit grey: value * `unit` = depth in world units, 0 where nothing is.

    Depths that do not fit are stored as 65535. The unit is in the file's text too: "depth_unit".
    """
    values = np.where(depth > 0, np.clip(np.round(depth / unit), 1, 65535), 0).astype(">u2")
    height, width = values.shape
    rows = np.zeros((height, 1 + 2 * width), np.uint8)  # each row starts with filter 0: none
    rows[:, 1:] = values.view(np.uint8).reshape(height, 2 * width)
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)),
        (b"tEXt", b"depth_unit\0" + repr(unit).encode("ascii")),
        (b"IDAT", zlib.compress(rows.tobytes(), 6)),
        (b"IEND", b""),
    )
    content = [b"\x89PNG\r\n\x1a\n"]
    for kind, body in chunks:
        check = struct.pack(">I", zlib.crc32(kind + body))
        content += [struct.pack(">I", len(body)), kind, body, check]
    atomic_write(path, b"".join(content))
