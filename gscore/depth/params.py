"""Depth parameters: depth_params.json with scale and offset of each map, as in 3DGS."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..datasets.folder import same_name
from ..errors import DatasetError, FormatError
from ..io.colmap.folder import find_model
from ..io.files import atomic_write, read_bytes
from ..json_text import parse_json
from ..quoting import brief, quoted
from .fit import Fit, scale_reason
from .maps import DepthKind, stem

FILE = "depth_params.json"
DEPTH_FOLDER = "depths"
"""Folder in the capture to which `gscore depth` writes maps."""
_REMAKE = "Make it again: gscore depth SOURCE"


@dataclass(frozen=True, kw_only=True)
class Params:
    """Entry of one view. All fields but `scale` and `offset` are extensions by gscore."""

    scale: float
    """1/world unit per unit of the map; 0: not aligned."""
    offset: float
    """1/world unit."""
    kind: DepthKind = DepthKind.INVERSE
    """Kind of the map; official tools support inverse depth only."""
    accepted: bool = True
    """Whether the map may be used."""
    reason: str = ""
    """Reason of a refusal."""
    inliers: float | None = None
    """Share of the points that agree, in [0, 1]; None: unknown."""
    points: int | None = None
    """Number of points compared; None: unknown."""
    error: float | None = None
    """Median relative difference of inverse depths; None: unknown."""


def params_path(root: Path, maps: Path, *, writing: bool = False) -> Path:
    """Path of depth_params.json for a folder of maps.

    Official tools read it from `sparse/0`, next to the COLMAP model, and support one folder of
    maps. So the file of `depths` is there; that of any other folder is in the folder itself, and if
    it has none, the one in `sparse/0` is read, as official tools do.

    Args:
        root: Folder of the capture.
        maps: Folder of the maps.
        writing: Return the path to write, not the path to read.
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
        Entries by the keys of `key_of`.

    Raises:
        DatasetError: the file does not exist, or has another layout.
        FormatError: it is not JSON, or an entry has no numbers `scale` and `offset`.
    """
    if not path.is_file():
        raise DatasetError(
            f"There is no {path} with the scales of the depth maps. Make it with: gscore depth "
            f"SOURCE"
        )
    try:
        content = parse_json(read_bytes(path))
    except ValueError as error:
        raise FormatError(f"{path} is not JSON ({error}). {_REMAKE}") from error
    _check_layout(path, content)
    return {
        same_name(name): _entry(f"{path}: {brief(name)}", entry) for name, entry in content.items()
    }


def key_of(view: str) -> str:
    """Key of a view in the result of `read_params`: its name without ending, in Unicode's NFC."""
    return same_name(stem(view))


def refusal(path: Path, key: str, entry: Params | None, median: float) -> str:
    """Why a training does not use the entry of a view; empty if it does.

    Args:
        path: The file.
        key: Name of the view without ending.
        entry: Entry of the view; None: missing.
        median: Median scale of all entries.
    """
    if entry is None:
        return f"{path.name} has no entry {quoted(key)}"
    reason = entry.reason if not entry.accepted else scale_reason(entry.scale, median)
    return reason or ("" if entry.scale > 0 else f"{path.name} gives it no scale")


def write_params(path: Path, fits: Mapping[str, Fit], kind: DepthKind) -> None:
    """Write the file atomically.

    Official tools read `scale` and `offset`; a refused view has the scale 0, which is unreliable to
    them. The other keys are extensions by gscore.

    Args:
        path: The file.
        fits: Fits by name of the view without ending.
        kind: Kind of the maps.

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
    """Raise unless the content maps names to objects; name the other known layout."""
    entries = list(content.values()) if isinstance(content, dict) else content
    first = entries[0] if isinstance(entries, list) and entries else None
    keys = set(content) if isinstance(content, dict) else set()
    keys |= set(first) if isinstance(first, dict) else set()
    if keys & {"depth_map", "depth_scale"} and "scale" not in keys:
        raise DatasetError(
            f"{path} has the layout with depth_map, camera and depth_scale, which has one unit of "
            f"metric depth, expected scale and offset of inverse depth in each view. Remove it and "
            f"run: gscore depth SOURCE --kind depth"
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
    """A finite number, or None for anything else: these keys are only reported."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if is_number and math.isfinite(value) else None
