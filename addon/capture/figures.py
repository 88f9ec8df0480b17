"""Figures of a run by photo, from metrics.json; no bpy."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..core import headline_psnr

MEASURED = "errors"
"""Subfolder of a run with the metrics of all photos and the splats coloured by error."""


@dataclass(frozen=True, kw_only=True)
class Figures:
    """PSNRs of photos."""

    path: Path
    """The metrics.json."""
    views: Mapping[str, float | None]
    """PSNR by photo name, dB; None: infinite or unknown."""

    @property
    def ranked(self) -> list[tuple[str, float]]:
        """Photos with a PSNR, the worst first."""
        known = [(name, psnr) for name, psnr in self.views.items() if psnr is not None]
        return sorted(known, key=lambda pair: pair[1])


def measured(run: Path) -> Figures | None:
    """Figures of all photos, written by *Measure Errors*; None if older than the training."""
    path = run / MEASURED / "metrics.json"
    try:
        if path.stat().st_mtime < (run / "point_cloud.ply").stat().st_mtime:
            return None
    except OSError:
        return None
    return _read(path)


def figures(run: Path) -> Figures:
    """Figures of all photos if measured, else of the photos that the training evaluated.

    Raises:
        ValueError: there are none, or the file cannot be read.
    """
    return measured(run) or _read(run / "metrics.json")


def _read(path: Path) -> Figures:
    try:
        content = json.loads(path.read_bytes())
        views = {str(view["name"]): headline_psnr(view) for view in content["views"]}
        known = {name: None if psnr is None else float(psnr) for name, psnr in views.items()}
    except (OSError, ValueError, RecursionError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(
            f"{path} has no figures of photos ({error!r}): train to the end to evaluate them."
        ) from error
    return Figures(path=path, views=known)
