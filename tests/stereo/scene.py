"""Photos of textured planes and balls with known depth at every pixel."""

from dataclasses import dataclass

import numpy as np

from gscore.raster.stereo_depth import StereoView


@dataclass(frozen=True)
class Scene:
    """A wall at z = 6, slanted by `slant`, and a ball in front of it, with cameras on an arc."""

    width: int = 96
    height: int = 72
    slant: float = 0.1
    flat: bool = False
    """The wall has no texture."""

    @property
    def K(self) -> np.ndarray:  # noqa: N802  as everywhere
        """[3, 3]."""
        f = 1.1 * self.width
        return np.array([[f, 0, self.width / 2], [0, f, self.height / 2], [0, 0, 1.0]])

    def viewmat(self, angle: float, height: float = 0.0) -> np.ndarray:
        """A camera that faces (0, 0, 5) from 5 away, `angle` degrees to the side."""
        a = np.radians(angle)
        center = np.array([5 * np.sin(a), height, 5 - 5 * np.cos(a)])
        forward = np.array([0, 0, 5.0]) - center
        forward /= np.linalg.norm(forward)
        right = np.cross([0, 1.0, 0], forward)
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = rotation, -rotation @ center
        return out

    def shot(self, viewmat: np.ndarray) -> tuple[StereoView, np.ndarray]:
        """The photo of a camera and its inverse depth [H, W]; four samples a pixel and axis."""
        n = 4
        greys, inverse = self._traced(viewmat, n)
        grey = greys.reshape(self.height, n, self.width, n).mean(axis=(1, 3))
        middle = self._traced(viewmat, 1)[1]
        del inverse
        return StereoView(np.rint(grey).astype(np.uint8), self.K, viewmat), middle

    def points(self, viewmat: np.ndarray, count: int, seed: int) -> np.ndarray:
        """[count, 3] visible places on surfaces."""
        rng = np.random.default_rng(seed)
        inverse = self._traced(viewmat, 1)[1]
        v = rng.integers(4, self.height - 4, count)
        u = rng.integers(4, self.width - 4, count)
        rays = np.stack([u + 0.5, v + 0.5, np.ones(count)], 1) @ np.linalg.inv(self.K).T
        local = rays / inverse[v, u][:, None]
        return (local - viewmat[:3, 3]) @ viewmat[:3, :3]

    def _traced(self, viewmat: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
        x = (np.arange(self.width * n) + 0.5) / n
        y = (np.arange(self.height * n) + 0.5) / n
        pixels = np.stack([*np.meshgrid(x, y), np.ones((len(y), len(x)))], -1)
        local = pixels @ np.linalg.inv(self.K).T
        rays = local @ viewmat[:3, :3]
        center = -viewmat[:3, :3].T @ viewmat[:3, 3]
        wall = (6 - center[2] - self.slant * center[0]) / (rays[..., 2] + self.slant * rays[..., 0])
        to = center - [0.3, 0.0, 4.6]
        b, a = (rays * to).sum(-1), (rays * rays).sum(-1)
        d = b * b - a * (to @ to - 0.8**2)
        ball = np.where(d > 0, (-b - np.sqrt(np.maximum(d, 0))) / a, np.inf)
        z = np.where(ball > 0, np.minimum(wall, ball), wall)
        places = center + rays * z[..., None]
        grey = 128 + 100 * _texture(places)
        if self.flat:
            grey = np.where(z == wall, 200.0, grey)
        return grey, 1 / z


def _texture(places: np.ndarray) -> np.ndarray:
    """Smooth noise in [-1, 1] that never repeats, finest waves 0.2 long."""
    rng = np.random.default_rng(3)
    total = np.zeros(places.shape[:-1])
    for length in (1.3, 0.7, 0.45, 0.31, 0.23):
        for _ in range(3):
            way = rng.normal(size=3)
            way *= 2 * np.pi / length / np.linalg.norm(way)
            total += np.sin(places @ way + rng.uniform(0, 6)) / 15
    return np.clip(2.2 * total, -1, 1)
