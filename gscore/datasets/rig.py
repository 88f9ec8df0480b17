"""Camera rig: captures by the same fixed cameras, moved to one set of cameras and one world."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import DatasetError
from ..quoting import first_few
from ..scene import PointCloud, camera_centers
from ..text_format import count_text
from .capture import Capture, View
from .pku.photos import camera_number

_FARTHEST = 0.02
"""Largest median distance between the cameras of equal rigs, in radii of the rig."""
_TURNED = np.deg2rad(2.0)
"""Largest median angle between the cameras of equal rigs, radians."""
_REPORTED = 2e-3
"""Largest distance, in radii of the rig, that is not reported: fits of one rig to photos differ by
less."""
_OUTLIER = 3.0
"""Cameras farther off than this many medians are excluded from the fit."""


@dataclass(frozen=True, kw_only=True)
class _Fit:
    """Similarity new = scale rotation old + shift, and its residual at each camera."""

    scale: float
    rotation: np.ndarray
    """[3, 3]"""
    shift: np.ndarray
    """[3]"""
    distances: np.ndarray
    """[C], residual distances in radii of the rig."""
    angles: np.ndarray
    """[C], residual angles, radians."""

    def move_points(self, points: np.ndarray) -> np.ndarray:
        """Transform world points [P, 3]."""
        return self.scale * points @ self.rotation.T + self.shift

    def move_viewmat(self, viewmat: np.ndarray) -> np.ndarray:
        """Transform a world-to-camera matrix [4, 4]; camera space is scaled too."""
        out = viewmat.copy()
        out[:3, :3] = viewmat[:3, :3] @ self.rotation.T
        out[:3, 3] = self.scale * viewmat[:3, 3] - out[:3, :3] @ self.shift
        return out


def with_rig(capture: Capture, rig: Capture, *, where: Path, rig_at: Path) -> Capture:
    """A capture with the cameras and world of another one by the same fixed cameras.

    Structure from motion on each frame of a video gives each its own origin, orientation, scale and
    focal length. Cameras are matched by the number in their names (`image_c_007_f_000005.png`,
    `007.png`), else by name; points are moved by the similarity between the two sets of cameras.
    Views that are not in the rig keep their own pose, moved as well.

    Args:
        capture: The capture to change.
        rig: The capture that provides the cameras.
        where: Path of `capture`, for messages.
        rig_at: Path of `rig`, for messages.

    Raises:
        DatasetError: fewer than two cameras are in both, or their arrangement differs.
    """
    targets = {_key(view.name): view for view in rig.views}
    pairs = [
        (view, targets[_key(view.name)]) for view in capture.views if _key(view.name) in targets
    ]
    if all(_same(view, target) for view, target in pairs) and len(pairs) == len(capture.views):
        return capture
    if len(pairs) < 2:
        raise DatasetError(
            f"{where} and {rig_at} have {count_text(len(pairs), 'camera')} in common, expected 2 "
            "or more; names "
            f"are like {capture.views[0].name} and {rig.views[0].name}. Give a capture by the same "
            f"cameras, with the same names or camera numbers."
        )
    fit = _fit(pairs)
    distance, angle = float(np.median(fit.distances)), float(np.median(fit.angles))
    if distance > _FARTHEST or angle > _TURNED:
        raise DatasetError(
            f"The cameras of {where} are not arranged as those of {rig_at}: they are off by "
            f"{100 * distance:.1f} % of the rig's radius and {np.rad2deg(angle):.1f} degrees in "
            f"the median. Take a rig with the same fixed cameras, or let each frame keep its own."
        )
    views = []
    for view in capture.views:
        target = targets.get(_key(view.name))
        if target is None:
            views.append(replace(view, viewmat=fit.move_viewmat(view.viewmat)))
        else:
            views.append(replace(view, viewmat=target.viewmat, camera=target.camera))
    warnings, farthest = [], float(fit.distances.max())
    if farthest > _REPORTED:
        warnings.append(
            f"The cameras of {count_text(len(pairs), 'view')} are those of {rig_at}, and the "
            "points were moved "
            f"into its world; the cameras' own positions differ by {100 * distance:.2f} % of the "
            f"rig's radius in the median, {100 * farthest:.2f} % at most."
        )
    lone = [view.name for view in capture.views if _key(view.name) not in targets]
    if lone:
        warnings.append(
            f"{count_text(len(lone), 'view is', 'views are')} not in {rig_at}: {first_few(lone)}."
        )
    return replace(
        capture,
        views=views,
        up=_up(capture, rig, fit),
        points=PointCloud(
            points=fit.move_points(capture.points.points), colors=capture.points.colors
        ),
        warnings=(*capture.warnings, *warnings),
    )


def _up(capture: Capture, rig: Capture, fit: _Fit) -> np.ndarray | None:
    if rig.up is not None or capture.up is None:
        return rig.up
    return fit.rotation @ capture.up


def _key(name: str) -> int | str:
    number = camera_number(name)
    return name if number is None else number


def _same(view: View, target: View) -> bool:
    a, b = view.camera, target.camera
    return (
        (a.model, a.width, a.height) == (b.model, b.width, b.height)
        and np.array_equal(a.params, b.params)
        and np.array_equal(view.viewmat, target.viewmat)
    )


def _fit(pairs: list[tuple[View, View]]) -> _Fit:
    """Similarity from the first cameras of the pairs to the second.

    The rotation is the mean one between paired cameras, so that it is defined also for rigs on a
    line or an arc, where the centres alone leave it open.
    """
    old = np.stack([view.viewmat for view, _ in pairs])
    new = np.stack([target.viewmat for _, target in pairs])
    turns = np.swapaxes(new[:, :3, :3], 1, 2) @ old[:, :3, :3]
    from_old, to_new = camera_centers(old), camera_centers(new)
    radius = float(np.linalg.norm(to_new - to_new.mean(axis=0), axis=1).max()) or 1.0
    kept = np.ones(len(pairs), bool)
    while True:
        u, _, vt = np.linalg.svd(turns[kept].sum(axis=0))
        rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
        turned = from_old @ rotation.T
        a = turned[kept] - turned[kept].mean(axis=0)
        b = to_new[kept] - to_new[kept].mean(axis=0)
        spread = float((a * a).sum())
        scale = float((a * b).sum()) / spread if spread > 0 else 1.0
        scale = scale if scale > 0 else 1.0
        shift = to_new[kept].mean(axis=0) - scale * turned[kept].mean(axis=0)
        distances = np.linalg.norm(scale * turned + shift - to_new, axis=1) / radius
        cosines = (np.einsum("cij,ij->c", turns, rotation) - 1) / 2
        angles = np.arccos(np.clip(cosines, -1, 1))
        good = kept & (distances <= _OUTLIER * max(float(np.median(distances)), 1e-9))
        if good.sum() < 2 or good.sum() == kept.sum():
            return _Fit(
                scale=scale, rotation=rotation, shift=shift, distances=distances, angles=angles
            )
        kept = good
