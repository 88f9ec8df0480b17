"""Splats: the model as raw numpy arrays, as in a 3DGS PLY and a checkpoint."""

from dataclasses import dataclass, fields, replace

import numpy as np

from .errors import ShapeError

PARAMETERS = ("means", "quats", "scales", "opacities", "sh0", "shN")
"""Parameters of a splat, in the order of the fields of `Splats` and of function arguments."""
SH_REST_BY_DEGREE = {0: 0, 1: 3, 2: 8, 3: 15, 4: 24}
"""Number of SH coefficients per channel beyond the constant one, by degree."""


def check_array(name: str, array: np.ndarray, shape: tuple[int | str, ...], dtype: type) -> None:
    """Raise ShapeError unless `array` has this dtype and shape; a str matches any size."""
    expected = "[" + ", ".join(str(s) for s in shape) + "]"
    fits = isinstance(array, np.ndarray) and array.ndim == len(shape)
    if fits:
        fits = all(isinstance(s, str) or s == n for s, n in zip(shape, array.shape, strict=True))
    if not fits or array.dtype != dtype:
        got = (
            f"{list(array.shape)} {array.dtype}"
            if isinstance(array, np.ndarray)
            else type(array).__name__
        )
        raise ShapeError(f"{name} must be {expected} {np.dtype(dtype).name}, got {got}.")


def sigmoid(logits: np.ndarray) -> np.ndarray:
    """Opacities from 0 to 1, float64, from logits of any shape."""
    return 1 / (1 + np.exp(-np.clip(logits.astype(np.float64), -_LARGEST_LOGIT, _LARGEST_LOGIT)))


_LARGEST_LOGIT = 700.0
"""Largest logit whose exponential fits float64."""


@dataclass(frozen=True, kw_only=True)
class Splats:
    """N Gaussians with raw (not activated) parameters, float32.

    Activation: `exp(scales)`, `sigmoid(opacities)`, `quats / |quats|`,
    colour = max(0, 0.5 + SH), in the encoding of the training images (sRGB values in [0, 1]).
    """

    means: np.ndarray
    """[N, 3], world units."""
    quats: np.ndarray
    """[N, 4], wxyz, of any non-zero length."""
    scales: np.ndarray
    """[N, 3], natural log of the standard deviations in world units."""
    opacities: np.ndarray
    """[N], logit."""
    sh0: np.ndarray
    """[N, 1, 3], constant SH coefficient, RGB."""
    shN: np.ndarray
    """[N, K-1, 3], higher SH coefficients, K = (degree + 1)^2; K-1 is 0, 3, 8, 15 or 24."""

    def __post_init__(self) -> None:
        check_array("means", self.means, ("N", 3), np.float32)
        n = len(self.means)
        check_array("quats", self.quats, (n, 4), np.float32)
        check_array("scales", self.scales, (n, 3), np.float32)
        check_array("opacities", self.opacities, (n,), np.float32)
        check_array("sh0", self.sh0, (n, 1, 3), np.float32)
        check_array("shN", self.shN, (n, "K-1", 3), np.float32)
        if self.shN.shape[1] not in SH_REST_BY_DEGREE.values():
            raise ShapeError(
                f"shN must have 0, 3, 8, 15 or 24 coefficients per splat (degree 0 to 4), "
                f"got {self.shN.shape[1]}."
            )

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """Degree of the stored SH coefficients, 0 to 4."""
        rest = self.shN.shape[1]
        return next(d for d, count in SH_REST_BY_DEGREE.items() if count == rest)

    def subset(self, index: np.ndarray) -> "Splats":
        """The splats selected by a boolean mask [N] or an integer index."""
        return Splats(**{f.name: getattr(self, f.name)[index] for f in fields(self)})


def cut_degree(splats: Splats, degree: int) -> Splats:
    """The model with SH coefficients up to this degree; unchanged if it has no more."""
    if degree >= splats.sh_degree:
        return splats
    return replace(splats, shN=splats.shN[:, : SH_REST_BY_DEGREE[degree]])
