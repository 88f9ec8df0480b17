"""Depth parameters: depth_params.json with scale and offset of each map, as in 3DGS."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import DatasetError, FormatError
from ..io.colmap.folder import find_model
from ..io.files import atomic_write, read_bytes
from ..json_text import parse_json
from ..quoting import brief, quoted
from .fit import Fit, scale_reason
from .maps import DepthKind

FILE = "depth_params.json"
DEPTH_FOLDER = "depths"
"""Where `gscore depth` writes maps, relative to the capture."""
_REMAKE = "Make it again: gscore depth SOURCE"


@dataclass(frozen=True, kw_only=True)
class Params:
    """What the file says of one view."""

    scale: float
    """1/world unit per unit of the map; 0: its maker could not align it."""
    offset: float
    """1/world unit."""
    kind: DepthKind = DepthKind.INVERSE
    """What the map's numbers grow with. An addition of ours: official tools know inverse depth."""
    accepted: bool = True
    """Whether its maker would use it. An addition of ours."""
    reason: str = ""
    """Why not. An addition of ours."""
    inliers: float | None = None
    """Share of the points that agree, in [0, 1]; None: not stated. An addition of ours."""
    points: int | None = None
    """Points that were compared; None: not stated. An addition of ours."""
    error: float | None = None
    """Median relative difference of inverse depths; None: not stated. An addition of ours."""


def params_path(root: Path, maps: Path, *, writing: bool = False) -> Path:
    """Where the file of some maps lies or belongs.

    Official tools look in `sparse/0`, beside the COLMAP model, and know one folder of maps. So the
    file of `depths` lies there; that of any other folder lies with its maps, and where it does not,
    the one in `sparse/0` is taken to speak of them, as official tools take it.

    Args:
        root: Folder of the capture.
        maps: Folder of the maps.
        writing: Where to write it, not where it may be read.
    """
    own = maps / FILE
    if own.is_file() or (writing and maps.resolve() != (root / DEPTH_FOLDER).resolve()):
        return own
    official = root / "sparse" / "0" / FILE
    if official.is_file():
        return official
    try:
        return find_model(root)[0] / FILE
    except DatasetError:
        return root / FILE


def read_params(path: Path) -> dict[str, Params]:
    """Read the file.

    Returns:
        By name of the view without ending.

    Raises:
        DatasetError: there is no such file, or it holds another layout.
        FormatError: it is no JSON, or an entry has no numbers `scale` and `offset`.
    """
    if not path.is_file():
        raise DatasetError(
            f"There is no {path}, which says how the depth maps are scaled. Make it "
            f"with: gscore depth SOURCE"
        )
    try:
        content = parse_json(read_bytes(path))
    except ValueError as error:
        raise FormatError(f"{path} is not JSON ({error}). {_REMAKE}") from error
    _check_layout(path, content)
    return {name: _entry(f"{path}: {brief(name)}", entry) for name, entry in content.items()}


def refusal(path: Path, key: str, entry: Params | None, median: float) -> str:
    """Why a training does not use what the file says of a view; empty if it does.

    Args:
        path: The file.
        key: Name of the view without ending.
        entry: What the file says of it.
        median: Median scale of all entries.
    """
    if entry is None:
        return f"{path.name} has no entry {quoted(key)}"
    reason = entry.reason if not entry.accepted else scale_reason(entry.scale, median)
    return reason or ("" if entry.scale > 0 else f"{path.name} gives it no scale")


def write_params(path: Path, fits: Mapping[str, Fit], kind: DepthKind) -> None:
    """Write the file completely or not at all.

    Official tools read `scale` and `offset`; a refused view has the scale 0, which they take for
    unreliable. The other keys tell people and gscore more.

    Args:
        path: The file.
        fits: By name of the view without ending.
        kind: What the maps' numbers grow with.

    Raises:
        GsError: the file cannot be written.
    """
    content = {}
    for name, fit in sorted(fits.items()):
        entry: dict[str, Any] = {
            "scale": fit.scale if fit.accepted else 0.0,
            "offset": fit.offset if fit.accepted else 0.0,
            "accepted": fit.accepted,
            "inliers": round(fit.inliers, 4),
            "points": fit.points,
            "error": round(fit.error, 5) if math.isfinite(fit.error) else None,
        }
        if fit.reason:
            entry["reason"] = fit.reason
        if kind is DepthKind.DEPTH:
            entry["kind"] = kind.value
        content[name] = entry
    text = json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False)
    atomic_write(path, (text + "\n").encode("utf-8"))


def _check_layout(path: Path, content: Any) -> None:
    """Raise unless the content maps names to objects; name the other layout that is met."""
    entries = list(content.values()) if isinstance(content, dict) else content
    first = entries[0] if isinstance(entries, list) and entries else None
    keys = set(content) if isinstance(content, dict) else set()
    keys |= set(first) if isinstance(first, dict) else set()
    if keys & {"depth_map", "depth_scale"} and "scale" not in keys:
        raise DatasetError(
            f"{path} has the layout with depth_map, camera and depth_scale, which states one unit "
            f"of metric depth but neither the scale nor the offset of inverse depth in each view. "
            f"Remove it and run: gscore depth SOURCE --kind depth"
        )
    if not isinstance(content, dict) or not all(isinstance(e, dict) for e in content.values()):
        raise FormatError(
            f'{path}: expected an object like {{"view_001": {{"scale": 1.2, "offset": 0.1}}}}. '
            f"{_REMAKE}"
        )


def _entry(where: str, entry: dict[str, Any]) -> Params:
    def number(key: str) -> float:
        value: Any = entry.get(key)
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not math.isfinite(value):
            stated = "missing" if key not in entry else quoted(value)
            raise FormatError(f"{where}: {key} is {stated}, expected a finite number. {_REMAKE}")
        return float(value)

    kind = entry.get("kind", DepthKind.INVERSE.value)
    if kind not in (DepthKind.INVERSE, DepthKind.DEPTH):
        raise FormatError(f"{where}: kind is {quoted(kind)}, expected inverse or depth. {_REMAKE}")
    return Params(
        scale=number("scale"),
        offset=number("offset"),
        kind=DepthKind(kind),
        accepted=entry.get("accepted") is not False,
        reason=str(entry.get("reason", "")),
        inliers=_known(entry.get("inliers")),
        points=None if (points := _known(entry.get("points"))) is None else int(points),
        error=_known(entry.get("error")),
    )


def _known(value: Any) -> float | None:
    """A finite number, or None for anything else: what is only told need not be right."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if is_number and math.isfinite(value) else None
