"""What the depth experiment measures: the depth that test views show against the exact one."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gscore.depth.maps import MapFolder, read_map
from gscore.io.images.read_image import read_mask, resize
from gscore.io.ply.splats import read_ply
from gscore.raster.api import Rendered, render

from .captures import Source, exact, photo

AGREE = 0.05
"""Relative difference of depths up to which two views show the same surface."""


@dataclass(frozen=True, kw_only=True)
class TestView:
    """A held-out view of a training."""

    name: str
    shown: Rendered
    truth: np.ndarray
    """[H, W] float64 exact inverse depth at the size of the render, 1/world unit, 0 = nothing."""
    seen: np.ndarray
    """[H, W] bool: a training view shows the surface of this pixel."""


def test_views(source: Source, out: Path) -> list[TestView]:
    """Render the held-out views of the training in `out`."""
    splats, cameras = read_ply(out / "point_cloud.ply"), {}
    for camera in json.loads((out / "cameras.json").read_text()):
        cameras[Path(camera["img_name"]).stem] = camera
    names = {Path(name).stem: name for name in source.test}
    train = [camera for stem, camera in cameras.items() if stem not in names]
    key = (str(source.depths), *(f"{c['img_name']} {c['width']} {c['height']}" for c in train))
    others, found = None, []
    for stem, camera in cameras.items():
        if stem in names:
            K, viewmat = pinhole(camera)
            width, height = camera["width"], camera["height"]
            truth = _exact_at(source, camera)
            shown = render(splats, K, viewmat, width, height)
            if (*key, stem) not in _SEEN:
                others = others or [(*pinhole(c), _exact_at(source, c)) for c in train]
                _SEEN[*key, stem] = is_seen(truth, K, viewmat, others)
            seen = _SEEN[*key, stem]
            found.append(TestView(name=names[stem], shown=shown, truth=truth, seen=seen))
    return found


_SEEN: dict[tuple[str, ...], np.ndarray] = {}
"""What of a test view the training views show: the same for all trainings on them."""


def _exact_at(source: Source, camera: dict[str, Any]) -> np.ndarray:
    return at_size(exact(source, camera["img_name"]), camera["width"], camera["height"])


def measure(source: Source, out: Path, *, masked: bool) -> dict[str, float | None]:
    """Errors of depth and colour in the held-out views, also by whether a training view sees it.

    The depth error is the mean over pixels and test views of |z / exact z - 1|, at most 1, with z
    the median depth: a hole counts 1.

    Args:
        source: The capture.
        out: Results of a training on it.
        masked: Only pixels that are the figure's count, and no PSNR is taken.

    Returns:
        `depth_error` over all pixels; `depth_error_seen` and `psnr_seen` over those whose surface a
        training view shows; `depth_error_unseen` and `psnr_unseen` over the others; `unseen`, their
        share, and `holes`, the share without a depth. None: there are no such pixels.
    """
    depth, seen, colour, holes = [], [], [], []
    for view in test_views(source, out):
        known = view.truth > 0
        height, width = known.shape
        if masked:
            mask = source.folder / "masks" / f"{Path(view.name).stem}.png"
            known &= resize(read_mask(mask), width, height) == 255
        assert view.shown.median_depth is not None
        z = view.shown.median_depth[known]
        depth.append(np.minimum(np.abs(z * view.truth[known] - 1), 1))
        holes.append(z == 0)
        seen.append(view.seen[known])
        picture = resize(photo(source, view.name), width, height).astype(np.float64) / 255
        square = ((np.clip(view.shown.rgb, 0, 1) - picture) ** 2).mean(axis=-1)
        colour.append(square[known])
    errors, squares, where = (np.concatenate(parts) for parts in (depth, colour, seen))
    found: dict[str, float | None] = {
        "depth_error": float(errors.mean()),
        "unseen": float(1 - where.mean()),
        "holes": float(np.concatenate(holes).mean()),
    }
    for key, part in (("seen", where), ("unseen", ~where)):
        found[f"depth_error_{key}"] = float(errors[part].mean()) if part.any() else None
        if not masked:
            found[f"psnr_{key}"] = (
                float(-10 * np.log10(squares[part].mean())) if part.any() else None
            )
    return found


def known_share(folder: Path, names: list[str]) -> float:
    """Share of the pixels of these photos whose depth the maps in `folder` state."""
    maps = [MapFolder(folder).find(name) for name in names]
    known = [0.0 if path is None else float((read_map(path) > 0).mean()) for path in maps]
    return float(np.mean(known))


def inverse(depth: np.ndarray) -> np.ndarray:
    """1 / depth, and 0 where it is 0."""
    return np.where(depth > 0, 1 / np.where(depth > 0, depth, 1), 0)


def is_seen(
    truth: np.ndarray,
    K: np.ndarray,
    viewmat: np.ndarray,
    train: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> np.ndarray:
    """[H, W] bool: the surface of the pixel lies in the frame of a training view, at its depth.

    Args:
        truth: [H, W] exact inverse depth of the view, 0 = nothing.
        K: [3, 3], pixels.
        viewmat: [4, 4], world to camera, OpenCV axes.
        train: K, viewmat and exact inverse depth of each training view.
    """
    height, width = truth.shape
    v, u = np.mgrid[:height, :width] + 0.5
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(K).T
    z = 1 / np.where(truth > 0, truth, 1)
    points = (rays * z[..., None] - viewmat[:3, 3]) @ viewmat[:3, :3]
    seen = np.zeros(truth.shape, bool)
    for other_K, other, inverse in train:
        local = points @ other[:3, :3].T + other[:3, 3]
        front = local[..., 2] > 0
        z = np.where(front, local[..., 2], 1)
        at = local @ other_K.T
        u, v = at[..., 0] / z, at[..., 1] / z
        rows, columns = inverse.shape
        inside = front & (u >= 0) & (u < columns) & (v >= 0) & (v < rows)
        pixel = np.where(inside, v, 0).astype(int), np.where(inside, u, 0).astype(int)
        seen |= inside & (np.abs(inverse[pixel] * z - 1) < AGREE)
    return seen & (truth > 0)


def at_size(values: np.ndarray, width: int, height: int) -> np.ndarray:
    """[height, width], the nearest of `values` at each pixel centre."""
    rows = ((np.arange(height) + 0.5) * values.shape[0] / height).astype(int)
    columns = ((np.arange(width) + 0.5) * values.shape[1] / width).astype(int)
    return values[np.ix_(rows, columns)]


def pinhole(camera: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """K and viewmat of an entry of cameras.json."""
    K = np.array(
        [
            [camera["fx"], 0, camera.get("cx", camera["width"] / 2)],
            [0, camera["fy"], camera.get("cy", camera["height"] / 2)],
            [0, 0, 1],
        ],
        np.float64,
    )
    viewmat = np.eye(4)
    viewmat[:3, :3] = np.array(camera["rotation"]).T
    viewmat[:3, 3] = -viewmat[:3, :3] @ np.array(camera["position"])
    return K, viewmat
