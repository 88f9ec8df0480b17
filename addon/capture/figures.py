"""Figures of a run by photo, from metrics.json; no bpy."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..core import headline_psnr

MEASURED = "errors"
"""Folder in that of a run: its metrics of all photos, and the splats in the colors of errors."""


@dataclass(frozen=True, kw_only=True)
class Figures:
    """PSNRs of photos."""

    path: Path
    """The file that has them."""
    views: Mapping[str, float | None]
    """dB by the name of the photo; None: infinite, or there is none."""

    @property
    def ranked(self) -> list[tuple[str, float]]:
        """Photos with a PSNR, the worst first."""
        found = [(name, psnr) for name, psnr in self.views.items() if psnr is not None]
        return sorted(found, key=lambda pair: pair[1])


def measured(run: Path) -> Figures | None:
    """Those of all photos, which *Measure Errors* wrote; None: not since the training."""
    path = run / MEASURED / "metrics.json"
    try:
        if path.stat().st_mtime < (run / "point_cloud.ply").stat().st_mtime:
            return None
    except OSError:
        return None
    return _read(path)


def figures(run: Path) -> Figures:
    """Those of all photos where they are there, else of those that the training evaluated.

    Raises:
        ValueError: there are none, or they cannot be read.
    """
    return measured(run) or _read(run / "metrics.json")


def _read(path: Path) -> Figures:
    try:
        content = json.loads(path.read_bytes())
        views = {str(view["name"]): headline_psnr(view) for view in content["views"]}
        known = {name: None if psnr is None else float(psnr) for name, psnr in views.items()}
    except (OSError, ValueError, RecursionError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(
            f"{path} tells of no photos ({error!r}): train to the end to have them evaluated."
        ) from error
    return Figures(path=path, views=known)
