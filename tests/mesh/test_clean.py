"""Oracles: meshes counted by hand."""

import numpy as np

from gscore.mesh.clean import (
    boundary_loops,
    close_holes,
    smoothed,
    used,
    vertex_normals,
    without_small_parts,
)


def _grid(side: int) -> tuple[np.ndarray, np.ndarray]:
    """A flat square of `side` x `side` vertices in the plane z = 0, normals along +z."""
    at = np.arange(side * side).reshape(side, side)
    a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    places = np.indices((side, side)).reshape(2, -1).T
    return np.pad(places.astype(np.float64), ((0, 0), (0, 1))), triangles


def test_small_parts_are_removed() -> None:
    """Oracle: squares of 2 x 9 and 2 x 2 squares; the share counts triangles of the largest."""
    vertices, triangles = _grid(10)
    more, small = _grid(3)
    both = np.concatenate([vertices, more + np.array([0, 0, 5])])
    faces = np.concatenate([triangles, small + len(vertices)])
    assert len(without_small_parts(both, faces, 0.04)) == len(faces)
    kept = without_small_parts(both, faces, 0.1)
    np.testing.assert_array_equal(kept, triangles)
    rows, same = used(both, kept)
    assert rows.tolist() == list(range(100))
    np.testing.assert_array_equal(same, triangles)
    assert len(without_small_parts(both, faces, 0)) == len(faces)
    assert len(without_small_parts(both, faces[:0], 0.1)) == 0


def test_loops_follow_the_border() -> None:
    """Oracle: 4 (n - 1) edges around a square, each once, in the direction of its triangle."""
    vertices, triangles = _grid(10)
    (loop,) = boundary_loops(triangles)
    assert len(loop) == 36
    steps = np.diff(vertices[np.append(loop, loop[0])], axis=0)
    assert (np.abs(steps).sum(axis=1) == 1).all()
    x, y = vertices[loop][:, :2].T
    area = (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2
    assert area == 81


def test_holes_of_every_size_are_closed() -> None:
    """Oracle: a square with a hole of n edges has two loops, and one once the hole is closed; the
    membrane is in its plane, faces as the square, and has the hole's area."""
    vertices, triangles = _grid(24)
    middles = vertices[triangles].mean(axis=1)
    for low, high in ((11, 12), (10, 13), (9, 15), (5, 18), (4, 17)):
        hole = ((middles[:, :2] > low) & (middles[:, :2] < high)).all(axis=1)
        faces = triangles[~hole]
        sizes = sorted(map(len, boundary_loops(faces)))
        assert len(sizes) == 2
        unchanged = close_holes(vertices, faces, sizes[0] - 1)
        assert [len(part) for part in unchanged] == [0, 0]
        added, filling = close_holes(vertices, faces, sizes[0])
        whole = np.concatenate([faces, filling])
        places = np.concatenate([vertices, added])
        assert list(map(len, boundary_loops(whole))) == [sizes[1]]
        np.testing.assert_allclose(added[:, 2], 0, atol=1e-12)
        a, b, c = (places[filling[:, i]] for i in range(3))
        areas = np.cross(b - a, c - a)[:, 2] / 2
        assert abs(areas.sum() - hole.sum() / 2) < 1e-9
        assert (areas >= -1e-12).all()


def test_an_open_border_of_odd_length_is_closed() -> None:
    """Oracle: fans of n triangles around a point, whose border has n edges, become closed."""
    for count in range(3, 40):
        turn = 2 * np.pi * np.arange(count) / count
        ring = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
        vertices = np.concatenate([ring, [[0, 0, 1.0]]])
        at = np.arange(count)
        triangles = np.stack([at, (at + 1) % count, np.full(count, count)], axis=1)
        added, filling = close_holes(vertices, triangles, None)
        whole = np.concatenate([triangles, filling])
        assert boundary_loops(whole) == []
        edges = np.unique(np.sort(whole[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
        assert len(vertices) + len(added) - len(edges) + len(whole) == 2


def test_smoothing_removes_noise_and_keeps_planes() -> None:
    """Oracle: a flat square stays to the rounding, its border too; noise on it becomes less; a
    vertex without triangles stays."""
    vertices, triangles = _grid(20)
    vertices = np.concatenate([vertices, [[7.0, 8, 9]]])
    np.testing.assert_allclose(smoothed(vertices, triangles, 5)[:, 2], vertices[:, 2], atol=1e-12)
    noisy = vertices.copy()
    noisy[:400, 2] = np.random.default_rng(0).normal(0, 0.1, 400)
    found = smoothed(noisy, triangles, 10)
    assert found[:400, 2].std() < 0.05
    np.testing.assert_array_equal(found[400], vertices[400])
    np.testing.assert_array_equal(smoothed(noisy, triangles, 0), noisy)
    normals = vertex_normals(vertices, triangles)
    np.testing.assert_allclose(normals[:400], np.tile([0, 0, 1], (400, 1)))
    assert not normals[400].any()
