"""Depth report: errors of the rendered depth against the depth maps, for metrics and report."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...report.depth import DepthPictures, DepthSection, depth_errors
from ...sampling import evenly_spaced
from ..photos.view_sampler import Photos
from .setup import DepthSetup

_MOST_VIEWS = 24
"""Most views that are rendered and shown, evenly spaced."""


@dataclass(frozen=True, kw_only=True)
class DepthReport:
    """Depth after a training."""

    numbers: dict[str, Any]
    """Entry of metrics.json: used, why, weights, error, and fits and errors by view."""
    section: DepthSection
    """Section of report.html."""


def measure_depth(
    photos: Photos,
    setup: DepthSetup,
    draw: Callable[[int], tuple[np.ndarray, np.ndarray]],
    *,
    interrupted: Callable[[], bool],
) -> DepthReport | None:
    """Render the inverse depth of views with a depth map and compare; None without maps.

    Args:
        photos: The capture.
        setup: Its depth maps.
        draw: Renders inverse depth and opacity of a view, see `VisibleSplats.inverse_depth`.
        interrupted: Called before each view; True stops.
    """
    targets = setup.targets
    if targets is None:
        return None
    names = photos.scene.cameras.names
    rows = [dict(row) for row in setup.table]
    for index, row in enumerate(rows):
        row["split"] = "test" if index in set(photos.test) else "train"
    with_map = [i for i in (*photos.test, *photos.train) if i in targets]
    pictures = DepthPictures(count=min(len(with_map), _MOST_VIEWS))
    for i in evenly_spaced(with_map, _MOST_VIEWS):
        if interrupted():
            break
        image = photos.image(i)
        target = targets.at(i, image.shape[1], image.shape[0])
        assert target is not None
        rendered, alpha = draw(i)
        rendered /= np.float32(targets.unit)
        prior = target.inverse_depth.numpy().astype(np.float32)
        confidence = target.confidence.numpy().astype(np.float32) / 255
        errors = depth_errors(rendered, alpha, prior, confidence) if target.aligned else {}
        rows[i] |= errors
        pictures.add(
            names[i], image, prior, confidence, rendered, aligned=target.aligned, numbers=rows[i]
        )
    found = [row["depth_error"] for row in rows if row.get("depth_error") is not None]
    numbers = {
        "used": setup.supervises,
        "why": setup.why,
        "weights": list(setup.weights),
        "unit": targets.unit,
        "depth_error": float(np.mean(found)) if found else None,
        "views": rows,
    }
    return DepthReport(
        numbers=numbers, section=DepthSection(why=setup.why, rows=rows, views=pictures.views)
    )
