"""Undistortion: distorted cameras, photos, masks and depths to pinhole; numpy only."""

from dataclasses import dataclass, replace

import numpy as np

from ..errors import DatasetError, FormatError
from ..io.colmap.lenses import distorted_pixels, undistorted_rays
from ..io.colmap.model import ColmapCamera
from ..io.images.resample import divided, premultiplied

_TAPS = (-1, 0, 1, 2)
"""Taps of cubic convolution along an axis, relative to the pixel before the position."""


class Pixels:
    """A picture, [h, w] or [h, w, D] of any dtype, for interpolation at many positions."""

    def __init__(self, image: np.ndarray) -> None:
        self._shape = image.shape[:2]
        self._flat = _packed(image)

    def bilinear(self, x: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
        """Fill `out` [r, W, ...], of the picture's dtype.

        Args:
            x: [r, W] columns, 0 to w - 1.
            y: [r, W] rows, 0 to h - 1.
            out: Receives the interpolated values.
        """
        height, width = self._shape
        left = np.minimum(x.astype(np.int64), max(width - 2, 0))
        top = np.minimum(y.astype(np.int64), max(height - 2, 0))
        fx, fy = (x - left).astype(np.float32), (y - top).astype(np.float32)
        at = top * width + left
        right, below = (1 if width > 1 else 0), (width if height > 1 else 0)
        corners = [_unpacked(self._flat[at + k], out) for k in (0, right, below, right + below)]
        channels = range(out.shape[2]) if out.ndim == 3 else [...]
        for c in channels:
            key = (..., c) if out.ndim == 3 else ...
            a, b, d, e = (corner[key].astype(np.float32) for corner in corners)
            a += fx * (b - a)
            d += fx * (e - d)
            a += fy * (d - a)
            out[key] = np.rint(a) if out.dtype.kind in "iu" else a

    def cubic(self, x: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
        """Like `bilinear`, for uint8, by cubic convolution (Keys 1981, with a = -1/2). Pixels at
        the border are repeated outwards."""
        height, width = self._shape
        left, top = x.astype(np.int64), y.astype(np.int64)
        across, down = _keys((x - left).astype(np.float32)), _keys((y - top).astype(np.float32))
        columns = [np.clip(left + k, 0, width - 1) for k in _TAPS]
        channels = range(out.shape[2]) if out.ndim == 3 else [...]
        sums = [np.zeros(x.shape, np.float32) for _ in channels]
        for k, weight_down in zip(_TAPS, down, strict=True):
            rows = np.clip(top + k, 0, height - 1) * width
            for column, weight_across in zip(columns, across, strict=True):
                pixels = _unpacked(self._flat[rows + column], out)
                weight = weight_down * weight_across
                for total, c in zip(sums, channels, strict=True):
                    total += weight * (pixels if c is ... else pixels[..., c])
        for total, c in zip(sums, channels, strict=True):
            np.clip(np.rint(total, out=total), 0, 255, out=total)
            out[... if c is ... else (..., c)] = total


def _keys(t: np.ndarray) -> tuple[np.ndarray, ...]:
    """Weights of the pixels at `_TAPS` for a position `t`, 0 to 1, after a pixel."""
    s = 1 - t
    return (
        -0.5 * t * s * s,
        1 + t * t * (1.5 * t - 2.5),
        1 + s * s * (1.5 * s - 2.5),
        -0.5 * s * t * t,
    )


def _packed(image: np.ndarray) -> np.ndarray:
    """[h w, ...] rows; uint8 colours packed into uint32, which gathers several times faster."""
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] not in (3, 4):
        return image.reshape(-1, *image.shape[2:])
    if image.shape[2] == 3:
        image = np.concatenate([image, np.zeros_like(image[..., :1])], axis=2)
    return np.ascontiguousarray(image).view(np.uint32).reshape(-1)


def _unpacked(values: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Undo `_packed` for gathered values [r, W] or [r, W, ...]."""
    if values.ndim == out.ndim:
        return values
    return np.ascontiguousarray(values).view(np.uint8).reshape(*values.shape, 4)


_ROWS_A_STRIP, _PIXELS_A_STRIP = 32, 1 << 17
_MOST_BLANK = 0.05
"""Largest share of the picture outside the photo, or beyond a fold of the distortion."""
_SCALES = (0.2, 2.0)
"""Least and largest size of the pinhole picture, in sizes of the photo."""
_WAYS, _STEPS = 33, 400
"""Search for folds: lines to each side of the picture, and samples on each line."""


@dataclass(frozen=True, kw_only=True)
class Undistortion:
    """The pinhole camera that replaces a distorted one, and the mapping between their pixels."""

    camera: ColmapCamera
    """The distorted camera."""
    width: int
    """Width of the pinhole camera, pixels of the scale of `camera`."""
    height: int
    """Height of the pinhole camera, pixels of the scale of `camera`."""
    K: np.ndarray
    """[3, 3] float64, intrinsics of the pinhole camera at that size."""
    cut_off: float = 0.0
    """Share of the picture left out at its rim, where the distortion folds back."""

    def distort(self, points: np.ndarray) -> np.ndarray:
        """Pixels of the distorted camera for pixels of the pinhole camera, both [P, 2] float64."""
        rays = (points - self.K[:2, 2]) / np.diag(self.K)[:2]
        return distorted_pixels(self.camera.model, self.camera.params.tolist(), rays)

    def undistort(self, points: np.ndarray) -> np.ndarray:
        """Pixels of the pinhole camera for pixels of the distorted camera, both [P, 2] float64; NaN
        where the distortion has no inverse."""
        return rays_of(self.camera, points) * np.diag(self.K)[:2] + self.K[:2, 2]

    def undistort_photo(self, photo: np.ndarray) -> np.ndarray:
        """Undistort a photo [h, w, 3 or 4] uint8 of the distorted camera, keeping its channels and
        pixel scale."""
        height, width = photo.shape[:2]
        pixels = (width / self.camera.width, height / self.camera.height)
        size = (round(self.width * pixels[0]), round(self.height * pixels[1]))
        opaque = photo.shape[2] == 3 or photo[..., 3].min() == 255
        colors = np.ascontiguousarray(photo[..., :3]) if opaque else premultiplied(photo)
        # Where alpha overshoots 255 and premultiplied colours do not, rims turn bright.
        colors = self.remap(colors, size, pixels=pixels, sharp=opaque)
        if photo.shape[2] == 3:
            return colors
        alpha = self.remap(np.ascontiguousarray(photo[..., 3]), size, pixels=pixels)
        return divided(colors, alpha)

    def remap(
        self,
        image: np.ndarray,
        size: tuple[int, int],
        *,
        pixels: tuple[float, float] = (1.0, 1.0),
        nearest: bool = False,
        sharp: bool = False,
    ) -> np.ndarray:
        """Resample an image of the distorted camera to the pinhole camera.

        Args:
            image: [h, w] or [h, w, D] of any dtype; channels are independent, so premultiply
                colours by alpha first.
            size: Width and height of the result, which always covers the whole pinhole image; its
                K is `scale_intrinsics(self.K, (self.width, self.height), size)`.
            pixels: Pixels of `image` per pixel of `camera`, each axis; not 1 if the photo has
                another size than the camera was calibrated at.
            nearest: Take the nearest pixel (labels, binary masks, depth) instead of interpolating
                bilinearly.
            sharp: Interpolate uint8 by cubic convolution, for photos that are not downscaled
                afterwards: bilinear interpolation loses half of the contrast of fine detail.

        Returns:
            [size[1], size[0], ...] of the dtype of `image`. Outside the photo its border is
            repeated.
        """
        height, width = image.shape[:2]
        out = np.zeros((size[1], size[0], *image.shape[2:]), image.dtype)
        columns = (np.arange(size[0]) + 0.5) * (self.width / size[0])
        lookup = Pixels(image)
        interpolate = lookup.cubic if sharp else lookup.bilinear
        # Strips keep positions in cache; those of a large photo would take gigabytes.
        strip = min(_ROWS_A_STRIP, max(1, _PIXELS_A_STRIP // size[0]))
        for top in range(0, size[1], strip):
            part = out[top : top + strip]
            rows = (np.arange(top, top + len(part)) + 0.5) * (self.height / size[1])
            grid = np.stack(np.meshgrid(columns, rows), axis=-1)
            source = self.distort(grid.reshape(-1, 2)).reshape(grid.shape) * pixels - 0.5
            x = np.clip(np.nan_to_num(source[..., 0]), 0, width - 1)
            y = np.clip(np.nan_to_num(source[..., 1]), 0, height - 1)
            if nearest:
                part[...] = image[np.rint(y).astype(np.int64), np.rint(x).astype(np.int64)]
            else:
                interpolate(x, y, part)
        return out


def rays_of(camera: ColmapCamera, pixels: np.ndarray) -> np.ndarray:
    """x / z and y / z of the rays through pixels of a distorted camera, both [P, 2] float64; NaN
    where the distortion has no inverse."""
    return undistorted_rays(camera.model, camera.params.tolist(), pixels)


def plan_undistortion(camera: ColmapCamera) -> Undistortion | None:
    """Undistortion of a camera without blank pixels; None if it is a pinhole camera.

    The pinhole camera is the one COLMAP's image undistorter would choose, without the rim in which
    the distortion folds back and the photo would repeat mirrored.

    Raises:
        DatasetError: the camera is equirectangular; no pinhole camera can replace it.
        FormatError: the parameters are invalid, or the distortion folds back in more than a rim.
    """
    if camera.is_pinhole:
        return None
    if camera.model == "EQUIRECTANGULAR":
        raise DatasetError(
            "The capture has 360 degree (EQUIRECTANGULAR) photos, which no pinhole camera can "
            "show. Cut them into ordinary views with COLMAP's panorama script first."
        )
    plan = _without_blanks(camera)
    plan = _unfolded(plan)
    _check_plan(plan)
    return plan


def _without_blanks(camera: ColmapCamera) -> Undistortion:
    """Largest picture at the camera's focal length that the photo fills, as chosen by COLMAP's
    image undistorter."""
    size = np.array([camera.width, camera.height])
    whole = Undistortion(camera=camera, width=camera.width, height=camera.height, K=camera.K)
    scale = np.ones(2)
    for axis, other in ((0, 1), (1, 0)):
        middle, rim = camera.K[axis, 2], np.empty((size[other], 2))
        rim[:, other] = np.arange(size[other]) + 0.5
        rim[:, axis] = 0.5
        near = np.fmax.reduce(whole.undistort(rim)[:, axis], initial=-np.inf)
        rim[:, axis] = size[axis] - 0.5
        far = np.fmin.reduce(whole.undistort(rim)[:, axis], initial=np.inf)
        # A side that no ray reaches sets no limit.
        with np.errstate(divide="ignore"):
            smaller = max(middle / (middle - near), (size[axis] - 0.5 - middle) / (far - middle))
        scale[axis] = min(max(1 / smaller, _SCALES[0]), _SCALES[1]) if smaller else _SCALES[1]
    width, height = np.maximum(1, (scale * size).astype(int)).tolist()
    K = camera.K
    K[:2, 2] *= np.array([width, height]) / size
    return Undistortion(camera=camera, width=width, height=height, K=K)


def _unfolded(plan: Undistortion) -> Undistortion:
    """The plan cropped at the first fold of the distortion, from the middle outwards.

    Raises:
        FormatError: more than a rim is lost.
    """
    size = np.array([plan.width, plan.height], np.float64)
    center = np.clip(plan.K[:2, 2], 0, size)
    good = _ways_to_fold(plan, center, _border(size))
    if good.min() == 1:
        return plan
    # Each line represents the triangle from the middle to its piece of the rim.
    beyond = 1 - float(np.mean(good**2))
    if beyond > _MOST_BLANK:
        raise FormatError(
            f"The {plan.camera.model} camera with parameters {plan.camera.params.tolist()} cannot "
            f"be undistorted: its distortion folds back, so that {100 * beyond:.0f} % of the "
            f"picture would show the rest of it mirrored. Run COLMAP again, perhaps with a simpler "
            f"camera model."
        )
    kept = float(good.min())
    first = np.ceil(center * (1 - kept))
    last = np.maximum(np.floor(center + (size - center) * kept), first + 1)
    K = plan.K.copy()
    K[:2, 2] -= first
    width, height = (last - first).astype(int).tolist()
    cut_off = 1 - width * height / (plan.width * plan.height)
    return replace(plan, width=width, height=height, K=K, cut_off=cut_off)


def _border(size: np.ndarray) -> np.ndarray:
    """[4 n, 2] points around the rim of a picture, its corners twice."""
    t = np.linspace(0, 1, _WAYS)
    low, high = np.zeros_like(t), np.ones_like(t)
    rim = [(t, low), (t, high), (low, t), (high, t)]
    return np.concatenate([np.column_stack(edge) for edge in rim]) * size


def _ways_to_fold(plan: Undistortion, center: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Share [P], 0 to 1, of the line from `center` to each of `ends` [P, 2] on which the distortion
    is one to one: up to the first sign change of the Jacobian of pinhole to photo pixels.
    """
    far = np.linspace(0, 1, _STEPS + 1)[1:]
    places = center + far[None, :, None] * (ends - center)[:, None]
    small = np.array([0.25, 0.25]) * np.eye(2)
    moved = [places, places + small[0], places + small[1]]
    distorted = [plan.distort(p.reshape(-1, 2)).reshape(places.shape) for p in moved]
    right, down = distorted[1] - distorted[0], distorted[2] - distorted[0]
    area = right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0]
    folded = ~(area > 0)  # also NaN
    # The last good step is the one before the first folded one.
    steps = np.where(folded.any(axis=1), folded.argmax(axis=1), _STEPS)
    return steps / _STEPS


def _check_plan(plan: Undistortion) -> None:
    """Raise FormatError if much of the pinhole image is outside the photo."""
    x, y = (np.linspace(0, size, 33) for size in (plan.width, plan.height))
    pixels = plan.distort(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    outside = (pixels < -1) | (pixels > [plan.camera.width + 1, plan.camera.height + 1])
    blank = float((outside | ~np.isfinite(pixels)).any(axis=1).mean())
    if blank > _MOST_BLANK:
        raise FormatError(
            f"The {plan.camera.model} camera with parameters {plan.camera.params.tolist()} cannot "
            f"be undistorted: {100 * blank:.0f} % of the picture would be outside the photo, so "
            f"the distortion is wrong. Run COLMAP again, perhaps with a simpler camera model."
        )
