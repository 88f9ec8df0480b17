"""State of a capture's depth maps by view; no bpy."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

ACCEPTED, REFUSED, MISSING, UNKNOWN = "accepted", "refused", "missing", "unknown"
"""Verdicts on a view's map. UNKNOWN: not compared with the points yet."""


@dataclass(frozen=True, kw_only=True)
class DepthRow:
    """Depth map of one view; unknown numbers are None."""

    view: str
    """Name of the photo in the capture."""
    verdict: str
    scale: float | None = None
    """1/world unit per unit of the map."""
    offset: float | None = None
    """1/world unit."""
    inliers: float | None = None
    """Share of the SfM points that agree with the map, 0 to 1."""
    points: int | None = None
    """Compared SfM points."""
    error: float | None = None
    """Median relative difference of map and points."""
    rendered: float | None = None
    """Mean relative difference of the splats' depth and the map, after a training."""
    split: str = ""
    """`train` or `test`, after a training."""
    reason: str = ""
    """Reason why the map is not used with its scale, a clause."""

    @property
    def name(self) -> str:
        """Short name: the view's without file extension."""
        return str(PurePosixPath(self.view).with_suffix(""))

    @property
    def fit(self) -> str:
        """Comparison in training: inverse depth = scale * value + offset, or Pearson."""
        if self.verdict == ACCEPTED and self.scale is not None and self.offset is not None:
            return f"{self.scale:.4g} {'+' if self.offset >= 0 else '-'} {abs(self.offset):.3g}"
        return "Pearson" if self.verdict == REFUSED else "-"

    def lines(self) -> list[tuple[str, str]]:
        """Label and value of each number, for a panel."""
        pairs = [("Map", "Not compared" if self.verdict == UNKNOWN else self.verdict.capitalize())]
        if self.verdict == ACCEPTED and self.scale is not None:
            pairs += [("Scale", f"{self.scale:.5g}"), ("Offset", f"{self.offset or 0.0:.5g}")]
        elif self.verdict == REFUSED:
            pairs.append(("Compared by", "correlation (Pearson)"))
        if self.inliers is not None and self.points is not None:
            pairs.append(("Inliers", f"{self.inliers:.0%} of {self.points:,} points"))
        if self.error is not None:
            pairs.append(("Map to points", f"{self.error:.1%}"))
        if self.rendered is not None:
            pairs.append(("Splats to map", f"{self.rendered:.1%}"))
        if self.split:
            pairs.append(("View", {"train": "training", "test": "held out"}[self.split]))
        return pairs


@dataclass(frozen=True)
class DepthReport:
    """Depth maps of all views of a capture."""

    rows: tuple[DepthRow, ...]
    """Sorted by name."""
    why: str = ""
    """Sentence on the use of depth in the training, with the reason."""

    @cached_property
    def by_view(self) -> Mapping[str, DepthRow]:
        """Rows by photo name."""
        return {row.view: row for row in self.rows}

    @cached_property
    def counts(self) -> Mapping[str, int]:
        """Number of views by verdict."""
        return Counter(row.verdict for row in self.rows)


def from_table(table: Sequence[Mapping[str, Any]], *, why: str = "") -> DepthReport:
    """A report from the rows that gscore writes.

    Raises:
        ValueError: a row is invalid.
    """
    try:
        rows = sorted((_row(entry) for entry in table), key=lambda row: row.view)
        return DepthReport(tuple(rows), why)
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(
            f"The depth report has an unexpected entry ({error}); make it again with Check Maps."
        ) from error


def read_run_report(output: Path) -> DepthReport | None:
    """The depth report in the metrics.json of a run; None without the file or a report in it.

    Raises:
        ValueError: the file is damaged.
    """
    path = output / "metrics.json"
    try:
        content = json.loads(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError) as error:
        raise ValueError(f"{path} cannot be read ({error}); train again to write it.") from error
    depth = content.get("depth") if isinstance(content, dict) else None
    if not isinstance(depth, dict) or not depth.get("views"):
        return None
    return from_table(depth["views"], why=str(depth.get("why", "")))


def _row(entry: Mapping[str, Any]) -> DepthRow:
    accepted = entry["accepted"]
    if entry["map"] is None:
        verdict = MISSING
    elif accepted is None:
        verdict = UNKNOWN
    else:
        verdict = ACCEPTED if accepted else REFUSED
    split = entry.get("split")
    points = _number(entry, "points")
    return DepthRow(
        view=str(entry["view"]),
        verdict=verdict,
        points=None if points is None else int(points),
        rendered=_number(entry, "depth_error"),
        split=split if split in ("train", "test") else "",
        reason=str(entry["reason"] or ""),
        **{key: _number(entry, key) for key in ("scale", "offset", "inliers", "error")},
    )


def _number(entry: Mapping[str, Any], key: str) -> float | None:
    value = entry.get(key)
    return None if value is None else value + 0.0
