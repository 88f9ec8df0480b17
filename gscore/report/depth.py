"""Depth section of the report: fits of the maps, and rendered compared to prior inverse depth."""

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..io.images.pixels import as_uint8
from ..text_format import count_text
from .colormap import colorize
from .pictures import data_uri, shrink, size_within

PICTURE_WIDTH = 240
"""Longer side of a picture, pixels."""
ERROR_WHITE = 0.25
"""Relative difference with the brightest colour."""
PICTURE_KINDS = ("photo", "prior", "aligned prior", "rendered", "difference")
_SURE = 0.5
"""Minimum confidence of counted pixels."""


@dataclass(frozen=True, kw_only=True)
class DepthViewPictures:
    """One row of pictures, `data:` URIs by name in PICTURE_KINDS; missing kinds do not exist."""

    name: str
    width: int
    height: int
    numbers: Mapping[str, Any]
    uris: Mapping[str, str]


@dataclass(frozen=True, kw_only=True)
class DepthSection:
    """Contents of the report."""

    why: str
    """Whether the depth loss was used, and why."""
    rows: Sequence[Mapping[str, Any]]
    """One row per view: view, split, points, scale, offset, inliers, error, accepted, reason and,
    if measured, depth_error."""
    views: Sequence[DepthViewPictures]


def depth_errors(
    rendered: np.ndarray, alpha: np.ndarray, prior: np.ndarray, confidence: np.ndarray
) -> dict[str, float | None]:
    """Mean relative difference of inverse depths at confident pixels of the prior.

    Missing opacity of a pixel counts as error, because haze in front of a surface could have the
    same inverse depth. A pixel counts at most 1, because a faint splat right in front of the camera
    has a huge inverse depth.

    Args:
        rendered: [H, W] accumulated inverse depth.
        alpha: [H, W] accumulated opacity.
        prior: [H, W] in the same unit.
        confidence: [H, W] in [0, 1].

    Returns:
        `depth_error`; None without confident pixels.
    """
    sure = (confidence >= _SURE) & (prior > 0)
    if not sure.any():
        return {"depth_error": None}
    relative = np.abs(rendered[sure] - prior[sure]) / prior[sure] + (1 - alpha[sure])
    return {"depth_error": float(np.minimum(relative, 1.0).mean(dtype=np.float64))}


@dataclass(kw_only=True)
class DepthPictures:
    """Collects rows of pictures as thumbnails."""

    count: int
    """Expected number of rows."""
    views: list[DepthViewPictures] = field(default_factory=list)

    def add(
        self,
        name: str,
        photo: np.ndarray,
        prior: np.ndarray,
        confidence: np.ndarray,
        rendered: np.ndarray,
        *,
        aligned: bool,
        numbers: Mapping[str, Any],
    ) -> None:
        """Add one view.

        Args:
            name: Name of the view.
            photo: [H, W, 3] uint8.
            prior: [H, W] inverse depth in medians of the capture, or from 0 to 1 if not aligned.
            confidence: [H, W] in [0, 1].
            rendered: [H, W] accumulated inverse depth in medians of the capture.
            aligned: Whether the prior has the scale of the capture.
            numbers: Row of the view.
        """
        height, width = photo.shape[:2]
        size = size_within(width, height, PICTURE_WIDTH)
        known = confidence > 0
        low, high = np.quantile(prior[known], (0.02, 0.98)) if known.any() else (0.0, 1.0)
        spread = float(high - low) or 1.0
        shapes = {"prior": np.where(known, (prior - low) / spread, 0)}
        top = float(high) if aligned else float(np.quantile(rendered, 0.98)) or 1.0
        if aligned:
            shapes["aligned prior"] = np.where(known, prior / top, 0)
            relative = np.abs(rendered - prior) / np.maximum(prior, 1e-6)
            shapes["difference"] = np.where(known, relative / ERROR_WHITE, 0)
        shapes["rendered"] = rendered / top
        uris = {"photo": data_uri(shrink(photo, size))}
        for kind, values in shapes.items():
            levels = as_uint8(values)
            uris[kind] = data_uri(colorize(shrink(levels, size) / 255.0))
        self.views.append(
            DepthViewPictures(name=name, width=size[0], height=size[1], numbers=numbers, uris=uris)
        )


def depth_html(section: DepthSection) -> str:
    """The section of the report."""
    cards = "".join(_card(view) for view in section.views)
    return (
        f'<section id="depth"><h2>Depth</h2><p class="hint">{html.escape(section.why)} Bright is '
        f"near. Prior: original values, stretched; aligned prior and render: common scale; "
        f"difference: relative, brightest from {ERROR_WHITE:.0%}, black without confidence."
        f"</p>{_table(section.rows)}{cards}</section>\n"
    )


def _card(view: DepthViewPictures) -> str:
    name = html.escape(view.name, quote=True)
    figures = "".join(
        f'<figure><img src="{view.uris[kind]}" width="{view.width}" height="{view.height}" '
        f'loading="lazy" alt="{kind} of {name}"><figcaption>{kind}</figcaption></figure>'
        if kind in view.uris
        else f'<figure><p class="empty">no {kind}</p></figure>'
        for kind in PICTURE_KINDS
    )
    return (
        f'<div class="depth-card"><h3>{name} <small>{html.escape(str(view.numbers["split"]))} '
        f'view, {_verdict(view.numbers)}</small></h3><div class="five">{figures}</div></div>'
    )


def _verdict(row: Mapping[str, Any]) -> str:
    error = row.get("depth_error")
    shown = "" if error is None else f"; rendered depth differs by {error:.1%}"
    if row["accepted"] and not row["points"]:
        return f"aligned as stated, no points to compare with{shown}"
    if row["accepted"]:
        return f"aligned, {row['inliers']:.0%} of {count_text(row['points'], 'point')} agree{shown}"
    return f"not aligned: {html.escape(str(row['reason']))}{shown}"


def _table(rows: Sequence[Mapping[str, Any]]) -> str:
    head = "".join(
        f"<th>{name}</th>"
        for name in ("view", "split", "points", "scale", "offset", "inliers", "error of the fit")
    )
    body = "".join(
        f"<tr><th>{html.escape(str(row['view']))}</th><td>{row['split']}</td>"
        f"<td>{row['points']}</td><td>{row['scale']:.4g}</td><td>{row['offset']:.4g}</td>"
        f"<td>{row['inliers']:.0%}</td><td>{_percent(row.get('error'))}</td>"
        f"<td>{_percent(row.get('depth_error'))}</td>"
        f"<td>{'accepted' if row['accepted'] else 'refused'}</td>"
        f"<td>{html.escape(str(row['reason']))}</td></tr>"
        for row in rows
    )
    accepted = sum(1 for row in rows if row["accepted"])
    return (
        f"<details><summary>Fits: {accepted} of {count_text(len(rows), 'view')} accepted</summary>"
        f'<div class="wide"><table><thead><tr>{head}<th>error of the render</th><th>verdict</th>'
        f"<th>reason</th></tr></thead><tbody>{body}</tbody></table></div></details>"
    )


def _percent(value: float | None) -> str:
    return "n/a" if value is None else f"{value:.1%}"
