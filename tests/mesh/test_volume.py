"""Oracle: the definition of the fusion, voxel by voxel in float64."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from gscore.mesh.contour import contour
from gscore.mesh.surface_view import surface_view
from gscore.mesh.volume import (
    SIDE,
    TRUNCATION,
    SurfaceView,
    Volume,
    blocks_near,
    of_double_voxels,
    packed,
    unpacked,
)
from gscore.raster.api import render_camera
from tests.mesh.shapes import around, sphere


def _by_definition(view: SurfaceView, points: np.ndarray, truncation: float) -> np.ndarray:
    """[N, 6], what a view adds to voxels at points [N, 3]; in the order of `dense_part`."""
    found = np.zeros((len(points), 6))
    for row, point in enumerate(points):
        x, y, z = view.viewmat[:3, :3] @ point + view.viewmat[:3, 3]
        if z <= 0:
            continue
        u, v = view.K[0, 0] * x / z + view.K[0, 2], view.K[1, 1] * y / z + view.K[1, 2]
        height, width = view.depth.shape
        if not (0 <= u < width and 0 <= v < height):
            continue
        pixel = int(v), int(u)
        weight, plane = float(view.weight[pixel]), view.planes[pixel].astype(np.float64)
        along = (view.depth[pixel] - z) / truncation
        distance = (plane[:3] @ [x, y, z] - plane[3]) / truncation if along <= 3 else 1.0
        if weight == 0 or distance <= -1 or along <= -3:
            continue
        distance = min(distance, 1.0)
        weight *= min((1 + distance) * TRUNCATION / (TRUNCATION - 1), 1)
        near = weight * (1 - abs(distance))
        rgb = view.rgb[pixel].astype(np.float64)
        found[row] = [weight * distance, weight, *(near * rgb), near]
    return found


def test_fusion_is_as_defined() -> None:
    """Oracle: the definition in float64; voxels that round to another pixel, and those at the
    limits of a case, differ, and are a few of a thousand."""
    splats, cameras = sphere(1500), around(4, size=60)
    voxel = 0.12
    views = [
        surface_view(
            render_camera(splats, cameras, i, depths=True, normals=True),
            *(cameras.Ks[i], cameras.viewmats[i]),
            spread=2 * TRUNCATION * voxel,
            far=10.0,
        )
        for i in range(len(cameras))
    ]
    volume = Volume(blocks_near(splats.means.astype(np.float64), voxel), voxel)
    expected = np.zeros((len(volume), SIDE**3, 6))
    steps = np.indices((SIDE,) * 3).reshape(3, -1).T
    with ThreadPoolExecutor(2) as pool:
        for view in views:
            volume.fuse(view, pool)
            for row, block in enumerate(unpacked(volume.keys)):
                points = (block * SIDE + steps) * voxel
                expected[row] += _by_definition(view, points, volume.truncation)
    found = np.concatenate(
        [volume.distances[..., None], volume.weights[..., None], volume.colors], axis=-1
    )
    assert (expected[..., 1] > 0).mean() > 0.3
    wrong = np.abs(found - expected).max(axis=-1) > 1e-4
    assert wrong.mean() < 0.005


def test_keys_and_blocks() -> None:
    """Oracle: the inverse; the order of keys is that of blocks; a point's voxel is in a block."""
    rng = np.random.default_rng(0)
    blocks = rng.integers(-1000, 1000, (200, 3))
    np.testing.assert_array_equal(unpacked(packed(blocks)), blocks)
    order = np.lexsort(blocks.T[::-1])
    assert (np.diff(packed(blocks[order])) >= 0).all()
    points = rng.normal(0, 3, (500, 3))
    keys = blocks_near(points, 0.1)
    own = packed(np.floor(points / 0.1 / SIDE).astype(np.int64))
    assert np.isin(own, keys).all()
    double = of_double_voxels(keys)
    assert np.isin(packed(np.floor(points / 0.2 / SIDE).astype(np.int64)), double).all()
    assert len(double) < len(keys)


def test_parts_of_a_contour_are_welded() -> None:
    """Oracle: a plane of known place over several parts: one vertex per crossed grid edge."""
    blocks = np.stack(np.meshgrid(*[np.arange(-9, 9)] * 2, [0], indexing="ij"), -1).reshape(-1, 3)
    keys = np.sort(packed(blocks))
    volume = Volume(keys, 0.5)
    heights = np.indices((SIDE,) * 3)[2].reshape(-1)
    volume.weights[:] = 2
    volume.distances[:] = 2 * (heights - 3.25) / 10
    volume.colors[:] = [0.5, 0.25, 0, 0.5]
    vertices, triangles, colors = contour(volume)
    side = 18 * SIDE
    assert len(vertices) == side * side
    assert len(triangles) == 2 * (side - 1) ** 2
    np.testing.assert_allclose(vertices[:, 2], 3.25 * 0.5, atol=1e-6)
    np.testing.assert_allclose(colors, np.tile([1, 0.5, 0], (len(colors), 1)), atol=1e-5)
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()
