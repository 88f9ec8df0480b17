"""Display filters as a numpy mask: the twin of the node group `nodes.filters`; no bpy."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import attributes
from ..core import at_least_opaque, in_unit_shape, of_size

SPHERE = "SPHERE"
BOX = "BOX"
ATTRIBUTES = (attributes.BASE, attributes.POSITION, attributes.SCALE)
"""Attributes that the filters read."""


@dataclass(frozen=True, kw_only=True)
class Filters:
    """Filter limits. Lengths are in the object's own units, before its scale."""

    opacity_min: float = 0.0
    """Smallest opacity, in [0, 1]."""
    size_min: float = 0.0
    """Smallest size; a splat's size is its largest standard deviation."""
    size_max: float = 0.0
    """Largest size, 0 for no limit."""
    crop: np.ndarray | None = None
    """[4, 4] float64 from object space to a space in which the crop is [-1, 1]³, or None."""
    crop_shape: str = BOX
    """BOX, or SPHERE for the ellipsoid that touches the box's sides."""
    crop_invert: bool = False
    """Show the outside of the crop."""

    @property
    def leave_out_anything(self) -> bool:
        """True if the filters may hide a splat."""
        limits = (self.opacity_min, self.size_min, self.size_max)
        return any(limits) or self.crop is not None


def mask(
    means: np.ndarray, scales: np.ndarray, opacities: np.ndarray, filters: Filters
) -> np.ndarray:
    """[N] bool, True for splats that pass.

    Args:
        means: [N, 3] in object space.
        scales: [N, 3] standard deviations, linear.
        opacities: [N] in [0, 1].
        filters: The limits, inclusive.
    """
    keep = at_least_opaque(opacities, filters.opacity_min)
    keep &= of_size(scales, filters.size_min, filters.size_max)
    if filters.crop is not None:
        inside = in_unit_shape(means, filters.crop, sphere=filters.crop_shape == SPHERE)
        keep &= inside != filters.crop_invert
    return keep


def passing(columns: dict[str, np.ndarray], limits: Filters) -> np.ndarray:
    """[N] bool, True for splats that pass.

    Args:
        columns: Copies of the attributes `ATTRIBUTES`, as `attributes.column`.
        limits: As `mask`.
    """
    base = columns[attributes.BASE]
    if not len(base):
        return np.zeros(0, bool)
    means, scales = columns[attributes.POSITION], columns[attributes.SCALE]
    return mask(means, scales, base[:, 3], limits)


def filters_of(ob: Any) -> Filters:
    """Filters from a splat object's settings and crop object."""
    settings = ob.gscore
    return Filters(
        opacity_min=settings.opacity_min,
        size_min=settings.size_min,
        size_max=settings.size_max,
        crop=crop_matrix(ob, settings.crop_object) if is_cropped(ob) else None,
        crop_shape=settings.crop_shape,
        crop_invert=settings.crop_invert,
    )


def is_cropped(ob: Any) -> bool:
    """True if the object has a crop object with a non-zero scale on some axis."""
    crop = ob.gscore.crop_object
    return crop is not None and any(any(row[:3]) for row in crop.matrix_world[:3])


def visible_mask(ob: Any) -> np.ndarray:
    """[N] bool: vertices of a splat object that its display shows.

    Raises:
        ValueError: attributes are missing or not accessible in Edit Mode.
    """
    # Blender drops `position` from a mesh without vertices.
    names = ATTRIBUTES if attributes.point_count(ob.data) else (attributes.BASE,)
    return passing({name: attributes.column(ob.data, name) for name in names}, filters_of(ob))


def crop_matrix(ob: Any, crop: Any) -> np.ndarray:
    """[4, 4] float64 from `ob`'s space to that in which the bounds of `crop` are [-1, 1]³.

    Along an axis without extent (all three of an empty) the bounds are one unit to each side.
    """
    corners = np.array([tuple(corner) for corner in crop.bound_box], np.float64)
    if crop.type == "EMPTY":
        corners[:] = 0
    middle = (corners.max(axis=0) + corners.min(axis=0)) / 2
    half = np.ptp(corners, axis=0) / 2
    half[half == 0] = 1
    to_unit = np.eye(4)
    to_unit[:3, :3] = np.diag(1 / half)
    to_unit[:3, 3] = -middle / half
    world, box = (
        np.array([tuple(row) for row in matrix], np.float64)
        for matrix in (ob.matrix_world, crop.matrix_world)
    )
    if not np.linalg.det(box[:3, :3]):  # a crop without volume contains nothing
        return np.array([[0, 0, 0, 2.0]] * 3 + [[0, 0, 0, 1.0]])
    return to_unit @ np.linalg.inv(box) @ world
