"""Stereo depth of photos by the native library: a plane sweep, and consistency of the maps."""

import ctypes as ct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import ShapeError
from . import _native, arguments, header
from .buffers import UINT8, address
from .request import CancelFlag


@dataclass(frozen=True)
class Warp:
    """Map from pixels of one view to another: a point at (x, y) with inverse depth d projects to
    (u, v), where (u w, v w, w) = rotation (x, y, 1) + d translation."""

    rotation: np.ndarray
    """[3, 3] float64."""
    translation: np.ndarray
    """[3] float64."""


@dataclass(frozen=True)
class StereoView:
    """A photo in grey and its camera."""

    grey: np.ndarray
    """[H, W] uint8, contiguous."""
    K: np.ndarray
    """[3, 3] float64, px; pixel centres are at +0.5."""
    viewmat: np.ndarray
    """[4, 4] float64, world to camera, OpenCV axes."""

    def warp_to(self, other: "StereoView") -> Warp:
        """Warp from pixels of this view to those of another."""
        pose = other.viewmat @ np.linalg.inv(self.viewmat)
        return Warp(other.K @ pose[:3, :3] @ np.linalg.inv(self.K), other.K @ pose[:3, 3])


@dataclass(frozen=True)
class SweepResult:
    """Result of a plane sweep at the pixels of its reference; all arrays [H, W] float32."""

    inverse_depth: np.ndarray
    """Inverse depth of the best plane, 1/world unit; 0 if it is not an inner maximum."""
    score: np.ndarray
    """Zero-mean normalised cross-correlation at that depth, -1 to 1."""
    second_best: np.ndarray
    """Score of the second best depth, more than two planes away; -1: there is none."""
    contrast: np.ndarray
    """Standard deviation of the grey values around the pixel."""


def sweep(
    reference: StereoView,
    sources: Sequence[StereoView],
    *,
    farthest: float,
    nearest: float,
    planes: int,
    radius: int = 3,
    best: int = 2,
    noise: float = 1.5,
    threads: int = 0,
    cancel: CancelFlag | None = None,
) -> SweepResult:
    """Plane sweep: the inverse depth of each pixel at which the sources match the reference best.

    Planes parallel to the reference's picture are evenly spaced in inverse depth (Collins 1996);
    windows are compared by zero-mean normalised cross-correlation, and the score of a plane is the
    mean over the `best` sources with the highest correlation, because others may be occluded.

    Args:
        reference: View whose depth is computed.
        sources: 1 to 8 overlapping views.
        farthest: Inverse depth of the first plane, 1/world unit, at least 0.
        nearest: Inverse depth of the last plane, 1/world unit.
        planes: Number of planes, 3 to 1024.
        radius: Windows are 2 radius + 1 px wide and high; 1 to 7.
        best: 1 or 2; at most the number of sources.
        noise: Standard deviation of the noise of grey values; lowers the score of flat windows.
        threads: 0: all cores.
        cancel: Set it from another thread to stop.

    Raises:
        ShapeError: an array, size or number is invalid.
        BackendError: the native library is missing or out of memory.
        Cancelled: `cancel` was set.
    """
    shape = _shape(reference.grey)
    array = (header.StereoSourceStruct * len(sources))()
    for struct, source in zip(array, sources, strict=True):
        height, width = size = _shape(source.grey)
        struct.width, struct.height = width, height
        struct.grey = address("grey", source.grey, size, UINT8)
        struct.warp = _warp(reference.warp_to(source))
    found = SweepResult(*(np.zeros(shape, np.float32) for _ in range(4)))
    args = header.StereoSweepArgsStruct(
        width=shape[1],
        height=shape[0],
        grey=address("grey", reference.grey, shape, UINT8),
        source_count=len(sources),
        sources=array,
        farthest=farthest,
        nearest=nearest,
        planes=planes,
        radius=radius,
        best=min(best, max(len(sources), 1)),
        noise=noise,
        threads=arguments.library_threads(threads),
    )
    if cancel is not None:
        args.cancel = ct.pointer(cancel.value)
    out = header.StereoFoundStruct(
        *(address(name, getattr(found, name), shape) for name in SweepResult.__dataclass_fields__)
    )
    _native.raise_status(_native.library().gs_stereo_sweep(ct.byref(args), ct.byref(out)))
    return found


@dataclass(frozen=True)
class Checked:
    """Consistency of a depth map with other views; all arrays [H, W]."""

    agree: np.ndarray
    """uint8, number of views with the same surface."""
    contradict: np.ndarray
    """uint8, number of views that have a farther surface behind it."""
    inverse_depth: np.ndarray
    """float32, mean of the map and the agreeing ones, 1/world unit; 0: unknown."""


def check(
    reference: StereoView,
    inverse_depth: np.ndarray,
    neighbours: Sequence[tuple[StereoView, np.ndarray]],
    *,
    pixels: float = 1.0,
    relative: float = 0.01,
    passed: float = 0.05,
    threads: int = 0,
) -> Checked:
    """Compare the depth map of a view with those of others.

    Args:
        reference: The view.
        inverse_depth: [H, W] float32, its map, 1/world unit; 0: unknown.
        neighbours: At most 255 other views with their maps.
        pixels: Maximum reprojection distance of an agreeing view, px.
        relative: Maximum relative difference of inverse depths of an agreeing view.
        passed: Minimum relative distance of a contradicting surface behind the point.
        threads: 0: all cores.

    Raises:
        ShapeError: an array or number is invalid.
        BackendError: the native library is missing or out of memory.
    """
    shape = _shape(reference.grey)
    array = (header.StereoNeighbourStruct * len(neighbours))()
    for struct, (view, known) in zip(array, neighbours, strict=True):
        height, width = size = _shape(view.grey)
        struct.width, struct.height = width, height
        struct.inverse_depth = address("inverse_depth", known, size)
        struct.warp, struct.back = _warp(reference.warp_to(view)), _warp(view.warp_to(reference))
    args = header.StereoCheckArgsStruct(
        width=shape[1],
        height=shape[0],
        inverse_depth=address("inverse_depth", inverse_depth, shape),
        neighbour_count=len(neighbours),
        neighbours=array,
        pixels=pixels,
        relative=relative,
        passed=passed,
        threads=arguments.library_threads(threads),
    )
    counts = np.zeros((2, *shape), np.uint8)
    fused = np.zeros(shape, np.float32)
    _native.raise_status(
        _native.library().gs_stereo_check(
            ct.byref(args),
            *(address("counts", part, shape, UINT8) for part in counts),
            address("inverse_depth", fused, shape),
        )
    )
    return Checked(counts[0], counts[1], fused)


def _shape(grey: np.ndarray) -> tuple[int, int]:
    if grey.ndim != 2:
        raise ShapeError(f"grey must be [H, W] uint8, got {list(grey.shape)}.")
    return grey.shape[0], grey.shape[1]


def _warp(warp: Warp) -> ct.Structure:
    with np.errstate(over="ignore"):
        rotation, translation = (
            np.float32(part).ravel() for part in (warp.rotation, warp.translation)
        )
    return header.StereoWarpStruct(
        (ct.c_float * 9)(*rotation.tolist()), (ct.c_float * 3)(*translation.tolist())
    )
