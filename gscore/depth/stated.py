"""Stated alignment: the values of depth_params.json, without reading a map."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import DatasetError, GsError
from .fit import median_scale
from .maps import MapFolder, stem
from .params import DEPTH_FOLDER, key_of, params_path, read_params, refusal


@dataclass(frozen=True, kw_only=True)
class StatedDepth:
    """Maps of the views, and which of them a training would use according to the file."""

    params: Path
    """Path of depth_params.json, which may not exist."""
    entries: int = 0
    """Number of views with an entry."""
    problem: str = ""
    """Why the file cannot be read; empty if it can, or does not exist."""
    table: list[dict[str, Any]] = field(default_factory=list)
    """One row per view with the keys of `Priors.table`. `accepted` is None for a map that was not
    compared with the points yet; unknown numbers are None."""


def stated_depth(source: Path, views: Sequence[str], *, folder: str = DEPTH_FOLDER) -> StatedDepth:
    """Read depth_params.json and list the maps; fast, and never raises on damaged ones.

    The points are not compared; `gscore depth SOURCE --check` does that.

    Args:
        source: Folder of the capture.
        views: Names of the views.
        folder: Folder of the maps in the capture.
    """
    root = source / folder
    try:
        maps = MapFolder(root)
        found = {view: maps.find(view) for view in views}
    except (DatasetError, OSError):
        found = dict.fromkeys(views)
    path, problem, params = params_path(source, root), "", {}
    if path.is_file():
        try:
            params = read_params(path)
        except (GsError, OSError) as error:
            problem = str(error)
    median = median_scale([entry.scale for entry in params.values()])
    rows = []
    for view, file in found.items():
        entry = params.get(key_of(view))
        row: dict[str, Any] = {"view": view, "map": file.name if file else None}
        row |= dict.fromkeys(("points", "scale", "offset", "inliers", "error"))
        if file is None:
            verdict = False, "there is no depth map of it"
        elif not params:
            verdict = None, "not compared with the points yet"
        else:
            reason = refusal(path, stem(view), entry, median)
            verdict = not reason, reason
        if file is not None and entry is not None:
            row |= {"points": entry.points, "scale": entry.scale, "offset": entry.offset}
            row |= {"inliers": entry.inliers, "error": entry.error}
        rows.append(row | {"accepted": verdict[0], "reason": verdict[1]})
    known = sum(1 for view in views if key_of(view) in params)
    return StatedDepth(params=path, entries=known, problem=problem, table=rows)
