"""Options of a run as frozen dataclasses: the same objects behind command line, JSON and add-on."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class DataConfig:
    """What to read of a capture and how to divide it."""

    source: Path
    """Folder with the COLMAP model or transforms.json."""
    images: str = "images"
    """Folder of the photos, relative to `source`."""
    masks: str = ""
    """Folder of masks relative to `source`; empty: `masks/` where it exists, or the photos' alpha."""
    mask_mode: str = "auto"
    """`composite`: the mask is opacity, photos lie over the background; `ignore`: masked-out pixels do not count;
    `none`: masks are not read; `auto`: composite for photos with alpha, ignore for mask folders."""
    resolution: float = -1
    """-1: as is, but at most 1600 px wide; 1, 2, 4, 8: divided by that; larger: this many pixels wide."""
    eval: bool = False
    """Hold test views out of the training."""
    test_every: int = 8
    """Every n-th view by sorted name is a test view."""
    test_list: Path | None = None
    """Text file with the names of the test views, one a line; wins over the other rules."""
    test_last: int = 0
    """The last n views by sorted name are test views; 0: use `test_every`."""
    test_first: int = 0
    """The first n views by sorted name are test views; 0: use `test_every`."""
