"""Reader of a capture folder in any layout, with its origin; numpy only."""

import math
from dataclasses import replace

import numpy as np

from ..config import DataConfig
from ..errors import ConfigError, DatasetError
from ..io.colmap.folder import find_model
from ..scene import (
    camera_centers,
    distances,
    moved_viewmats,
    offset_between,
    origin_text,
    within_reach,
)
from .capture import Capture, View
from .colmap_source import read_colmap
from .folder import masks_by_photos
from .masks import masks_inside
from .pku.case import find_video, read_video
from .programs import find_program, read_program
from .rig import with_rig
from .transforms_json import find_transforms, read_transforms


def read_capture(
    config: DataConfig, *, photos_required: bool = True, origin: np.ndarray | None = None
) -> Capture:
    """Views, cameras and points of a COLMAP model, a transforms.json, a frame of a multi-view
    video, or the camera file of another program.

    No photo is decoded. With `config.rig`, cameras and world are those of that capture. If
    coordinates are too large for float32, views and points are relative to a local origin.

    Args:
        config: `source`, `images`, `frame` and `rig`.
        photos_required: Leave out views without a photo and refuse a capture that lacks most; else
            all views stay, with the path where their photo should be.
        origin: As for `about_origin`.

    Raises:
        DatasetError: there is no capture, or its photos are missing, or the rig differs.
        FormatError: a file is truncated, corrupt or of an unknown format.
        ConfigError: `frame` was given for a capture that has none.
    """
    capture = _with_masks(_read(config, photos_required))
    if config.rig is not None:
        rig = _read(DataConfig(source=config.rig), False)
        capture = with_rig(capture, rig, where=config.source, rig_at=config.rig)
        capture = replace(capture, origin=rig.origin)
    return about_origin(capture, origin)


def _with_masks(capture: Capture) -> Capture:
    """The capture with the masks next to its photos, if it states none and has no folder of
    masks."""
    if any(view.mask for view in capture.views) or masks_inside(capture.root) is not None:
        return capture
    found = masks_by_photos([view.image for view in capture.views])
    if not any(found):
        return capture
    views = [replace(view, mask=mask) for view, mask in zip(capture.views, found, strict=True)]
    return replace(capture, views=views)


def _read(config: DataConfig, photos_required: bool) -> Capture:
    video = find_video(config.source)
    if video is not None:
        return read_video(video, config, photos_required=photos_required)
    if config.frame is not None and config.source.exists():
        raise ConfigError(
            f"{config.source} is not a multi-view video, so it has no frame {config.frame}; "
            f"expected a folder with data_COLMAP, per_frame or per_view. Leave `--frame` out."
        )
    program = find_program(config.source, config.images) if config.source.is_file() else None
    if program is not None:
        return read_program(config, program, photos_required=photos_required)
    transforms = find_transforms(config.source)
    if transforms == config.source:
        return read_transforms(config, photos_required=photos_required)
    try:
        find_model(config.source)
    except DatasetError:
        if transforms is not None:
            return read_transforms(config, photos_required=photos_required)
        program = find_program(config.source, config.images)
        if program is None:
            raise
        return read_program(config, program, photos_required=photos_required)
    return read_colmap(config, photos_required=photos_required)


_TOLERANCE = 0.01
"""Pixels by which rounding to float32 may move a projected point."""
_GAIN = 4.0
"""Least factor by which a local origin must reduce that error; it cannot help a capture that is
itself large."""
_SAMPLED = 1000
"""Most views and points that are evaluated, evenly spaced."""
_ROUNDING = 2.0**-24
"""Relative rounding error of float32."""


def about_origin(capture: Capture, origin: np.ndarray | None = None) -> Capture:
    """The capture in coordinates relative to a local origin, subtracted in float64.

    Args:
        capture: The capture as in its files.
        origin: [3], the local origin in the capture's world; zeros: none; None: chosen by
            `choose_origin`.

    Returns:
        The capture, with `Capture.origin`; `capture` itself if nothing moves.
    """
    if origin is None:
        chosen = choose_origin(capture)
        if chosen is None:
            return capture
        origin = offset_between(capture.origin, None) + chosen
    shift = offset_between(origin, capture.origin)
    if not shift.any():
        return capture
    views = [replace(view, viewmat=moved_viewmats(view.viewmat, shift)) for view in capture.views]
    points = replace(capture.points, points=capture.points.points - shift)
    local = origin if origin.any() else None
    warnings = capture.warnings if local is None else (*capture.warnings, _warning(local))
    return replace(capture, views=views, points=points, origin=local, warnings=warnings)


def _warning(origin: np.ndarray) -> str:
    return (
        f"The capture is far from the origin of its coordinates, where float32 is too coarse: "
        f"splats and cameras are relative to the local origin {origin_text(origin)}, which "
        f"their files state."
    )


def choose_origin(capture: Capture) -> np.ndarray | None:
    """[3] float64, local origin amid the cameras, in the capture's coordinates; None if float32 is
    fine enough without.

    It is the median camera position, rounded to a power of ten no larger than the capture, so that
    it usually stays the same if some photos are left out.
    """
    step = max(1, len(capture.views) // _SAMPLED)
    if not capture.views:
        return None
    centers = camera_centers(np.stack([view.viewmat for view in capture.views]))
    if not within_reach(centers).all():
        return None
    middle = np.median(centers, axis=0)
    radius = _median(distances(centers, middle))
    if float(np.abs(middle).max()) <= radius:
        return None  # the usual case, decided without the points
    points = capture.points.points[:: max(1, len(capture.points) // _SAMPLED)]
    points = points[within_reach(points)]
    size = max(radius, _median(distances(points, middle)))
    if not size > 0:
        return None
    digits = -math.floor(math.log10(size))
    origin = np.array([round(value, digits) for value in middle.tolist()])
    views = list(zip(capture.views[::step], centers[::step], strict=True))
    before, after = (
        _median(np.array([_pixels(view, center, points, size, about) for view, center in views]))
        for about in (np.zeros(3), origin)
    )
    return origin if before > max(_TOLERANCE, _GAIN * after) else None


def _pixels(
    view: View, center: np.ndarray, points: np.ndarray, size: float, about: np.ndarray
) -> float:
    """Pixels by which a view's points move if coordinates relative to `about` [3] are rounded."""
    z = points @ view.viewmat[2, :3] + view.viewmat[2, 3]
    depth = _median(z[z > 0]) or size
    largest = float(np.abs(center - about).max()) + depth
    return float(view.camera.K[0, 0]) * largest * _ROUNDING / depth


def _median(values: np.ndarray) -> float:
    return float(np.median(values)) if len(values) else 0.0
