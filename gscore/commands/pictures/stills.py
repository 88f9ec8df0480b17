"""Rendered stills: file names, pictures and depth maps."""

from collections import Counter
from collections.abc import Sequence
from itertools import chain, count
from pathlib import Path, PurePosixPath

import numpy as np

from ...io.files import atomic_write, is_unnameable
from ...io.images.read_image import SIGNED, write_png
from ...raster.api import Rendered


def still_names(names: Sequence[str], *, depths: bool = False) -> list[str]:
    """A relative path without ending for each view, unique, whatever the capture calls them.

    Sub-folders stay; what would lead out of the output folder is dropped; names that differ in
    their ending only keep it. Names that differ in capitals only count as equal, as some systems
    take them.

    Args:
        names: Of the views.
        depths: Names with `_depth` behind them have to be free too.
    """
    stems = [_inside(str(PurePosixPath(n).with_suffix("")) if n else "view") for n in names]
    whole = [_inside(n.replace(".", "_")) for n in names]
    counts = Counter(stem.lower() for stem in stems)
    taken: set[str] = set()
    result: list[str] = []
    for i, stem in enumerate(stems):
        wanted = stem if counts[stem.lower()] == 1 else whole[i]
        choices = chain([wanted], (f"{wanted}_{number}" for number in count(i)))
        name = next(name for name in choices if not _files(name, depths=depths) & taken)
        taken |= _files(name, depths=depths)
        result.append(name)
    return result


def _files(name: str, *, depths: bool) -> set[str]:
    """The file at the name of a view, on case-insensitive file systems."""
    return {name.lower(), f"{name}_depth".lower()} if depths else {name.lower()}


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
    values = np.where(depth > 0, np.clip(np.round(depth / unit), 1, 65535), 0)
    write_png(path, values.astype(np.uint16), {"depth_unit": repr(unit)} | SIGNED)
