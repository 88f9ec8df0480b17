"""Write the golden values: gsplat's published formulas in plain numpy, splat by splat.

An independent check of the rasterizer's values. Written from the documentation of gsplat 1.5.3
(docs.gsplat.studio: rasterization, projection, spherical harmonics) and from Ye et al., "gsplat: An
Open-Source Library for Gaussian Splatting", arXiv 2409.06765, with its "Mathematical Supplement",
arXiv 2312.02121; it shares no code with gscore. Opacities stay below 0.9 and the picture is never
opaque, so that the versions' different alpha caps (0.99, 0.999) and the early stop do not matter.

Run `python tests/raster/golden/make_golden.py` to write gsplat_formulas.npz next to this file.
"""

import io
import math
from pathlib import Path

import numpy as np

WIDTH, HEIGHT, COUNT = 40, 30, 24
EPS2D, NEAR = 0.3, 0.01
OUTPUT = Path(__file__).parent / "gsplat_formulas.npz"


def make_inputs() -> dict[str, np.ndarray]:
    """Raw splats and a camera, float64; all but the view matrix are exact in float32.

    The view matrix is rigid to float64 accuracy, so the camera centre is the same by inverse and by
    transpose.
    """
    rng = np.random.default_rng(20240912)
    axis = np.array([0.3, -0.8, 0.52])
    axis /= np.linalg.norm(axis)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    angle = 0.9
    rotation = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = rotation, [0.4, -0.3, 1.0]
    K = np.array([[44.0, 0, 17.5], [0, 39.0, 16.0], [0, 0, 1]])

    z = rng.uniform(1.5, 5.0, COUNT)
    column = rng.uniform(-0.1, 1.1, COUNT) * WIDTH
    row = rng.uniform(-0.1, 1.1, COUNT) * HEIGHT
    column[:2] = [-0.9 * WIDTH, 1.8 * WIDTH]  # beyond the clamp of the Jacobian
    cam = np.stack([(column - 17.5) / 44 * z, (row - 16) / 39 * z, z], 1)
    sigma_px = np.exp(rng.uniform(np.log(0.6), np.log(9.0), (COUNT, 3)))
    sigma_px[:2] *= 6.0  # and still reaching into the picture
    inputs = {
        "means": (cam - viewmat[:3, 3]) @ rotation,
        "quats": rng.normal(size=(COUNT, 4)),
        "scales": np.log(sigma_px * z[:, None] / 44),
        "opacities": rng.uniform(-1.0, 2.2, COUNT),
        "sh0": 0.7 * rng.normal(size=(COUNT, 1, 3)),
        "shN": 0.2 * rng.normal(size=(COUNT, 15, 3)),
        "K": K,
        "background": np.array([0.2, 0.5, 0.8]),
    }
    exact = {name: np.float64(np.float32(value)) for name, value in inputs.items()}
    return {**exact, "viewmat": viewmat}


def rotation_of(quat: np.ndarray) -> np.ndarray:
    """R(q) of the supplement, wxyz, q normalised first."""
    w, x, y, z = quat / math.sqrt(sum(q * q for q in quat))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def project_one(mean, quat, log_scale, viewmat, K):
    """Mean, conic, depth and compensation of one splat."""
    W, t = viewmat[:3, :3], viewmat[:3, 3]
    x, y, z = W @ mean + t
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]

    tan_x, tan_y = 0.5 * WIDTH / fx, 0.5 * HEIGHT / fy
    x_limits = -(cx / fx + 0.3 * tan_x), (WIDTH - cx) / fx + 0.3 * tan_x
    y_limits = -(cy / fy + 0.3 * tan_y), (HEIGHT - cy) / fy + 0.3 * tan_y
    tx = z * min(max(x / z, x_limits[0]), x_limits[1])
    ty = z * min(max(y / z, y_limits[0]), y_limits[1])
    J = np.array([[fx / z, 0, -fx * tx / z**2], [0, fy / z, -fy * ty / z**2]])

    R, S = rotation_of(quat), np.diag(np.exp(log_scale))
    covar2d = J @ W @ R @ S @ S.T @ R.T @ W.T @ J.T
    det_before = np.linalg.det(covar2d)
    blurred = covar2d + EPS2D * np.eye(2)
    det = np.linalg.det(blurred)
    inverse = np.linalg.inv(blurred)
    return (
        np.array([fx * x / z + cx, fy * y / z + cy]),
        np.array([inverse[0, 0], (inverse[0, 1] + inverse[1, 0]) / 2, inverse[1, 1]]),
        z,
        math.sqrt(max(det_before / det, 0.0)),
    )


def harmonics(direction: np.ndarray) -> list[float]:
    """The 16 basis values of degree 3, with the decimal constants that 3DGS renderers use."""
    x, y, z = direction / math.sqrt(sum(d * d for d in direction))
    return [
        0.28209479177387814,
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (3 * z * z - 1),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (x * x - y * y),
        -0.5900435899266435 * y * (3 * x * x - y * y),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (5 * z * z - 1),
        0.3731763325901154 * z * (5 * z * z - 3),
        -0.4570457994644658 * x * (5 * z * z - 1),
        1.445305721320277 * z * (x * x - y * y),
        -0.5900435899266435 * x * (x * x - 3 * y * y),
    ]


def color_one(mean, sh0, shN, viewmat) -> np.ndarray:
    """max(SH + 0.5, 0) along the ray from the camera centre."""
    center = np.linalg.inv(viewmat)[:3, 3]
    basis = harmonics(mean - center)
    value = np.zeros(3)
    for b, coefficients in zip(basis, [*sh0, *shN], strict=True):
        value += b * coefficients
    return np.maximum(value + 0.5, 0.0)


def shade_pixel(px, py, order, means2d, conics, depths, opacities, colors):
    """Colour, transmittance and inverse depth of one pixel, front to back."""
    rgb, inverse_depth, T = np.zeros(3), 0.0, 1.0
    for i in order:
        dx, dy = means2d[i, 0] - px, means2d[i, 1] - py
        A, B, C = conics[i]
        sigma = 0.5 * (A * dx * dx + C * dy * dy) + B * dx * dy
        alpha = min(0.99, opacities[i] * math.exp(-sigma))
        if sigma < 0 or alpha < 1 / 255:
            continue
        rgb += T * alpha * colors[i]
        inverse_depth += T * alpha / depths[i]
        T *= 1 - alpha
    return rgb, T, inverse_depth


def compute() -> dict[str, np.ndarray]:
    """Inputs and golden values, plain and antialiased."""
    inputs = make_inputs()
    names = ("means", "quats", "scales", "viewmat", "K")
    means, quats, scales, viewmat, K = (inputs[name] for name in names)
    rows = [project_one(means[i], quats[i], scales[i], viewmat, K) for i in range(COUNT)]
    means2d, conics, depths, compensations = (
        np.array(column) for column in zip(*rows, strict=True)
    )
    assert (depths > NEAR).all()
    colors = np.array(
        [color_one(means[i], inputs["sh0"][i], inputs["shN"][i], viewmat) for i in range(COUNT)]
    )
    opacities = 1 / (1 + np.exp(-inputs["opacities"]))
    order = np.argsort(depths)
    golden = {
        "means2d": means2d,
        "conics": conics,
        "depths": depths,
        "compensations": compensations,
        "colors": colors,
    }
    for suffix, opacity in (("", opacities), ("_antialiased", opacities * compensations)):
        image = np.zeros((HEIGHT, WIDTH, 3))
        alpha, inverse_depth = np.zeros((HEIGHT, WIDTH)), np.zeros((HEIGHT, WIDTH))
        for row in range(HEIGHT):
            for column in range(WIDTH):
                rgb, T, inverse = shade_pixel(
                    column + 0.5, row + 0.5, order, means2d, conics, depths, opacity, colors
                )
                image[row, column] = rgb + T * inputs["background"]
                alpha[row, column], inverse_depth[row, column] = 1 - T, inverse
        golden |= {
            f"image{suffix}": image,
            f"alpha{suffix}": alpha,
            f"inverse_depth{suffix}": inverse_depth,
        }
    return {**{f"in_{name}": value for name, value in inputs.items()}, **golden}


if __name__ == "__main__":
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **compute())
    temporary = OUTPUT.with_suffix(".tmp")
    temporary.write_bytes(buffer.getvalue())
    temporary.replace(OUTPUT)
