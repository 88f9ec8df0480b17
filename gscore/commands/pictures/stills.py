"""Rendered stills: file names, pictures and depth maps."""

from collections import Counter
from collections.abc import Sequence
from itertools import chain, count
from pathlib import Path, PurePosixPath

import numpy as np

from ...io.files import atomic_write, is_unnameable
from ...io.images.pixels import as_uint8
from ...io.images.png import SIGNED, write_png
from ...raster.api import Rendered


def still_names(names: Sequence[str], *, depths: bool = False) -> list[str]:
    """A unique relative path without ending for each view, for any names in the capture.

    Sub-folders are kept; parts that lead out of the output folder are dropped; names that differ
    only in their ending keep it. Names that differ only in case count as equal, as on some file
    systems.

    Args:
        names: Names of the views.
        depths: Names followed by `_depth` must be unique too.
    """
    stems = [_inside(str(PurePosixPath(n).with_suffix("")) if n else "view") for n in names]
    whole = [_inside(n.replace(".", "_")) for n in names]
    counts = Counter(stem.lower() for stem in stems)
    taken: set[str] = set()
    result: list[str] = []
    for i, stem in enumerate(stems):
        best = stem if counts[stem.lower()] == 1 else whole[i]
        choices = chain([best], (f"{best}_{number}" for number in count(i)))
        name = next(name for name in choices if not _files(name, depths=depths) & taken)
        taken |= _files(name, depths=depths)
        result.append(name)
    return result


def _files(name: str, *, depths: bool) -> set[str]:
    """File names of a view on case-insensitive file systems."""
    return {name.lower(), f"{name}_depth".lower()} if depths else {name.lower()}


def _inside(name: str) -> str:
    parts = [p for p in name.replace("\\", "/").split("/") if p not in ("", ".", "..")]
    cleaned = ["".join("_" if _is_odd(c) else c for c in p) for p in parts]
    return "/".join(cleaned) or "view"


def _is_odd(letter: str) -> bool:
    """Whether some file system forbids the letter."""
    return letter in '<>:"|?*' or is_unnameable(letter)


def to_rgb(rendered: Rendered) -> np.ndarray:
    """[H, W, 3] uint8, the picture over its background."""
    return as_uint8(rendered.rgb)


def to_rgba(rendered: Rendered) -> np.ndarray:
    """[H, W, 4] uint8 with straight alpha, from a picture rendered over black.

    Over black the colours are premultiplied by alpha; PNG stores straight ones.
    """
    alpha = rendered.alpha[..., None]
    color = np.divide(rendered.rgb, alpha, out=np.zeros_like(rendered.rgb), where=alpha > 1e-4)
    return as_uint8(np.concatenate([color, alpha], axis=2))


def write_depth_npy(path: Path, depth: np.ndarray) -> None:
    """Write [H, W] float32 depths exactly, in world units; 0: empty."""
    atomic_write(path, lambda file: np.save(file, depth.astype(np.float32)))


def write_depth_png(path: Path, depth: np.ndarray, unit: float) -> None:
    """Write depths as 16-bit grey: value * `unit` = depth in world units, 0: empty.

    Larger depths are stored as 65535. The file states the unit as text: "depth_unit".
    """
    values = np.where(depth > 0, np.clip(np.round(depth / unit), 1, 65535), 0)
    write_png(path, values.astype(np.uint16), {"depth_unit": repr(unit)} | SIGNED)
