"""Lines in front of everything; oracle: the lines drawn without a depth."""

import numpy as np

from addon.live.depths import in_front


def test_lines_without_a_depth_are_found() -> None:
    """A slanted mesh covers the right half; two lines have depths and soft edges, two have none."""
    depths = np.ones((40, 60), np.float32)
    depths[:, 30:] = 0.99 + 1e-4 * np.arange(30)
    alphas = np.zeros((40, 60), np.uint8)
    want = np.zeros((40, 60), bool)
    for row, near in ((5, 0.97), (12, 0.98)):
        depths[row], alphas[row], alphas[row + 1] = near, 255, 200
    for row in (20, 30):
        alphas[row : row + 2], want[row : row + 2] = 200, True
    got = in_front(depths, alphas)
    away = np.abs(np.arange(60) - 30) > 3  # from the mesh's edge
    assert np.array_equal(got[:, away], want[:, away])
    assert not in_front(depths, np.zeros_like(alphas)).any()
