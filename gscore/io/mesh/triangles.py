"""Triangle mesh, and checks of meshes read from files."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import FormatError
from ...text_format import count_words, number

MOST_TRIANGLES = 20_000_000
"""Most triangles of a mesh: more take gigabytes without locating the surface better."""
_LARGEST = 1e9
"""Largest coordinate; scenes in any unit are smaller, and its products with K stay exact."""


@dataclass(frozen=True, kw_only=True)
class TriangleMesh:
    """Triangles with shared vertices."""

    vertices: np.ndarray
    """[V, 3] float64, world of the capture."""
    triangles: np.ndarray
    """[T, 3] int32, rows of `vertices`."""

    def __len__(self) -> int:
        return len(self.triangles)


def checked_mesh(path: Path, vertices: np.ndarray, triangles: np.ndarray) -> TriangleMesh:
    """Mesh of a file, after checks.

    Args:
        path: The file, for messages.
        vertices: [V, 3] float64.
        triangles: [T, 3] int64.

    Raises:
        FormatError: there are no triangles or too many, or one uses a vertex that does not exist or
            has coordinates that are not finite or too large.
    """
    if len(triangles) == 0:
        raise FormatError(
            f"{path} has no faces ({count_words(len(vertices), 'vertex', 'vertices')}). Export a "
            "mesh with faces; a point cloud has none."
        )
    check_count(path, len(triangles))
    outside = (triangles < 0) | (triangles >= len(vertices))
    if outside.any():
        row, corner = (int(at) for at in np.argwhere(outside)[0])
        raise FormatError(
            f"{path} is damaged: a face uses vertex {int(triangles[row, corner])} of "
            f"{number(len(vertices))}. Export it again."
        )
    with np.errstate(invalid="ignore"):
        good = (np.abs(vertices) <= _LARGEST).all(axis=1)
    used = np.zeros(len(vertices), bool)
    used[triangles.ravel()] = True
    wrong = np.flatnonzero(used & ~good)
    if len(wrong):
        raise FormatError(
            f"{path}: {count_words(len(wrong), 'vertex is', 'vertices are')} not finite or larger "
            f"than {_LARGEST:g}, the first one number {wrong[0]} (counted from 0): "
            f"{vertices[wrong[0]].tolist()}. "
            "Clean the mesh up and export it again."
        )
    points = vertices.copy()
    points[~good] = 0  # no face uses them
    return TriangleMesh(vertices=points, triangles=np.ascontiguousarray(triangles, np.int32))


def check_count(path: Path, triangles: int) -> None:
    """Raise FormatError for more than `MOST_TRIANGLES`."""
    if triangles > MOST_TRIANGLES:
        raise FormatError(
            f"{path} has {number(triangles)} triangles, at most {number(MOST_TRIANGLES)} are "
            "supported. Simplify the mesh; a hundred thousand are enough for a room."
        )


def fans(polygons: Sequence[np.ndarray]) -> np.ndarray:
    """[T, 3] int64 triangle fans around the first corners of polygons [n] int each; polygons with
    less than 3 corners give none."""
    sizes = np.fromiter((len(polygon) for polygon in polygons), np.int64, len(polygons))
    if not (sizes >= 3).any():
        return np.zeros((0, 3), np.int64)
    flat = np.concatenate(list(polygons)).astype(np.int64)
    starts = np.cumsum(sizes) - sizes
    counts = np.maximum(sizes - 2, 0)
    first = np.repeat(starts, counts)
    step = np.arange(len(first)) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.stack([flat[first], flat[first + step + 1], flat[first + step + 2]], axis=1)
