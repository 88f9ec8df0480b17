"""Patterns as images, sRGB in [0, 1], row 0 at v = 0: plaid, print, parquet, rug, canvas."""

import numpy as np


def fractal(shape, rng, slope=1.2, stretch=1.0):
    """Tileable noise: spectrum 1/f^slope, mean 0, standard deviation 1, `stretch` along rows."""
    fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1])[None]
    f = np.hypot(fy, fx * stretch)
    f[0, 0] = np.inf
    spectrum = np.fft.fft2(rng.standard_normal(shape)) / f**slope
    noise = np.fft.ifft2(spectrum).real
    return (noise - noise.mean()) / noise.std()


def over(image, color, alpha):
    """Blend a colour over an image in place; alpha [H, W]."""
    image += np.clip(alpha, 0, 1)[..., None] * (np.asarray(color) - image)


def mix(colors, t):
    """Colours [n, 3] at t in [0, 1], linearly interpolated."""
    colors = np.asarray(colors, float)
    x = np.linspace(0, 1, len(colors))
    return np.stack([np.interp(t, x, c) for c in colors.T], -1)


def stripes(n, scale, rng, palette):
    """[n, 3] colours of threads: bands of random width, `scale` pixels per centimetre."""
    row = np.empty((n, 3))
    at = 0
    while at < n:
        color = np.array(palette[rng.choice(len(palette), p=[0.42, 0.24, 0.16, 0.10, 0.08])])
        width = int(scale * rng.choice([0.35, 0.6, 1.2, 2.6], p=[0.3, 0.25, 0.25, 0.2]))
        row[at : at + width] = color + rng.normal(0, 0.015, 3)
        at += width
    return row


def plaid(n, meters, rng, hem):
    """Woven tartan without repetition, with an embroidered border; origin in the centre.

    Args:
        n: pixels of a side.
        meters: length of a side.
        hem: radius of the lower edge in the cloth's flat cut, metres; the border lies along it.
    """
    scale = n / meters / 100
    palette = [
        (0.10, 0.22, 0.27),
        (0.50, 0.12, 0.14),
        (0.16, 0.36, 0.34),
        (0.86, 0.74, 0.52),
        (0.85, 0.52, 0.18),
    ]
    warp, weft = stripes(n, scale, rng, palette), stripes(n, scale, rng, palette)
    y, x = np.mgrid[:n, :n]
    twill = ((x + y) // 2 % 2)[..., None]
    image = np.where(
        twill == 0,
        0.62 * warp[None] + 0.38 * weft[:, None],
        0.38 * warp[None] + 0.62 * weft[:, None],
    )
    image *= 1 + 0.05 * fractal((n, n), rng, 0.6)[..., None]
    u, v = (x - n / 2) / n * meters, (y - n / 2) / n * meters
    r = np.hypot(u, v)
    over(image, (0.13, 0.11, 0.16), smooth_band(r, hem - 0.088, hem - 0.018))
    for edge in (hem - 0.088, hem - 0.018):
        over(image, (0.88, 0.70, 0.36), smooth_band(r, edge - 0.0025, edge + 0.0025))
    colors = [
        (0.90, 0.78, 0.50),
        (0.78, 0.22, 0.20),
        (0.35, 0.60, 0.52),
        (0.92, 0.55, 0.25),
        (0.70, 0.76, 0.86),
    ]
    angle = -np.pi
    while angle < np.pi:
        radius = hem - 0.053 + rng.uniform(-0.012, 0.012)
        at = (
            radius * np.cos(angle) / meters * n + n / 2,
            radius * np.sin(angle) / meters * n + n / 2,
        )
        flower(image, at, scale * rng.uniform(0.9, 2.0), rng, colors)
        angle += rng.uniform(0.022, 0.045)
    return np.clip(image, 0, 1)


def smooth_band(r, low, high, soft=0.0008):
    """1 between low and high, with soft edges."""
    return np.clip((r - low) / soft, 0, 1) * np.clip((high - r) / soft, 0, 1)


def flower(image, at, size, rng, colors):
    """Paint one blossom of about `size` pixels radius, wrapping around the image's edges."""
    n, m = image.shape[:2]
    s = int(np.ceil(size * 1.2))
    j, i = np.mgrid[-s : s + 1, -s : s + 1]
    r, turn = np.hypot(i, j) / size, np.arctan2(j, i) + rng.uniform(0, 6.28)
    petals, sharp = rng.integers(4, 9), rng.uniform(0.15, 0.42)
    shape = 1 - sharp + sharp * np.cos(petals * turn)
    window = np.ix_((int(at[1]) + j[:, 0]) % n, (int(at[0]) + i[0]) % m)
    patch = image[window]
    first, second = rng.choice(len(colors), 2, replace=False)
    soft = size / 1.5
    over(patch, colors[first], (shape - r) * soft)
    over(
        patch,
        np.array(colors[first]) * 0.72,
        (0.75 * shape - r) * soft * (np.cos(2 * petals * turn) > 0.3),
    )
    over(patch, colors[second], (0.36 - r) * soft)
    over(patch, (0.25, 0.16, 0.12), (0.14 - r) * soft)
    image[window] = patch


def leaf(image, at, size, rng, color):
    """Paint one leaf of about `size` pixels half length, wrapping around the image's edges."""
    n, m = image.shape[:2]
    s = int(np.ceil(size * 1.1))
    j, i = np.mgrid[-s : s + 1, -s : s + 1]
    turn = rng.uniform(0, 6.28)
    u, v = (
        (i * np.cos(turn) + j * np.sin(turn)) / size,
        (j * np.cos(turn) - i * np.sin(turn)) / size,
    )
    window = np.ix_((int(at[1]) + j[:, 0]) % n, (int(at[0]) + i[0]) % m)
    patch = image[window]
    blade = 0.36 * (1 - u**2) - np.abs(v)
    over(patch, color, blade * size / 1.5)
    over(patch, np.array(color) * 0.6, np.minimum(blade, 0.035 - np.abs(v)) * size)
    image[window] = patch


def blossoms(n, rng, count=1500):
    """Tileable cotton print: blossoms and leaves of many sizes on cream."""
    image = np.ones((n, n, 3)) * (0.80, 0.76, 0.67)
    image *= 1 + 0.012 * fractal((n, n), rng, 0.5)[..., None]
    colors = [
        (0.73, 0.20, 0.22),
        (0.22, 0.34, 0.55),
        (0.93, 0.66, 0.22),
        (0.55, 0.26, 0.45),
        (0.90, 0.50, 0.44),
    ]
    greens = [(0.25, 0.42, 0.26), (0.42, 0.52, 0.28), (0.20, 0.36, 0.36)]
    unit = n / 100
    for _ in range(count):
        leaf(
            image, rng.uniform(0, n, 2), unit * rng.uniform(0.5, 1.5), rng, greens[rng.integers(3)]
        )
    for _ in range(count):
        flower(
            image,
            rng.uniform(0, n, 2),
            unit * rng.choice([0.35, 0.6, 1.0, 1.6], p=[0.35, 0.3, 0.25, 0.1]),
            rng,
            colors,
        )
    return np.clip(image, 0, 1)


def parquet(n, meters, rng):
    """Oak boards 14 cm wide with joints, grain and a few knots."""
    y, x = (np.mgrid[:n, :n] + 0.5) / n * meters
    row = (y // 0.14).astype(int)
    shift = rng.uniform(0, 2, row.max() + 1)[row]
    length = rng.uniform(0.7, 1.3, row.max() + 1)[row]
    board = ((x + shift) // length).astype(int)
    tone = rng.uniform(0, 1, (row.max() + 1, board.max() + 1))[row, board]
    jump = rng.integers(0, n, (row.max() + 1, board.max() + 1))[row, board]
    j, i = np.mgrid[:n, :n]
    grain = fractal((n, n), rng, 0.9, 14.0)[(j + 7 * jump) % n, (i + jump) % n]
    fine = fractal((n, n), rng, 0.4, 6.0)
    image = mix(
        [(0.30, 0.19, 0.12), (0.50, 0.34, 0.21), (0.64, 0.47, 0.31)],
        0.15 + 0.6 * tone + 0.13 * grain,
    )
    image *= 1 + 0.06 * fine[..., None]
    gap = np.minimum(
        np.minimum(y % 0.14, 0.14 - y % 0.14),
        np.minimum((x + shift) % length, length - (x + shift) % length),
    )
    image *= np.clip(0.25 + gap / 0.004, 0, 1)[..., None]
    return np.clip(image, 0, 1)


def rug(n, rng):
    """Knotted rug: field of motifs, medallion, three borders."""
    y, x = (np.mgrid[:n, :n] + 0.5) / n * 2 - 1
    image = np.ones((n, n, 3)) * (0.42, 0.12, 0.13)
    r = np.hypot(x, y)
    lobes = 0.56 + 0.05 * np.cos(12 * np.arctan2(y, x))
    for scale, color in (
        (1.0, (0.83, 0.70, 0.48)),
        (0.96, (0.13, 0.18, 0.30)),
        (0.55, (0.80, 0.64, 0.42)),
        (0.52, (0.45, 0.14, 0.14)),
    ):
        over(image, color, (lobes * scale - r) * n / 4)
    edge = np.maximum(np.abs(x), np.abs(y))
    for low, color in (
        (0.74, (0.82, 0.70, 0.48)),
        (0.755, (0.14, 0.19, 0.30)),
        (0.93, (0.82, 0.70, 0.48)),
        (0.945, (0.40, 0.12, 0.12)),
        (0.985, (0.75, 0.68, 0.55)),
    ):
        over(image, color, (edge - low) * n / 2)
    colors = [
        (0.84, 0.72, 0.50),
        (0.70, 0.28, 0.20),
        (0.30, 0.45, 0.48),
        (0.85, 0.50, 0.22),
        (0.20, 0.24, 0.38),
    ]
    greens = [(0.36, 0.44, 0.30), (0.62, 0.52, 0.30), (0.26, 0.36, 0.40)]
    for k in range(1300):
        at = rng.uniform(0, n, 2)
        if k % 2:
            leaf(image, at, n * rng.uniform(0.006, 0.017), rng, greens[rng.integers(3)])
        else:
            flower(image, at, n * rng.uniform(0.005, 0.018), rng, colors)
    image *= 1 + 0.10 * fractal((n, n), rng, 0.5)[..., None]
    return np.clip(image, 0, 1)


def canvas(rows, columns, rng):
    """Painted studio backdrop: broad clouds of grey and olive."""
    cloud = fractal((rows, columns), rng, 1.7)
    image = mix([(0.30, 0.31, 0.31), (0.42, 0.42, 0.40), (0.54, 0.52, 0.48)], 0.5 + 0.17 * cloud)
    return np.clip(image * (1 + 0.02 * fractal((rows, columns), rng, 0.7)[..., None]), 0, 1)


def knit(n, rng):
    """Stocking: rings of different width and colour, knit in rows; v runs up the leg over 0.5 m."""
    palette = [
        (0.20, 0.22, 0.30),
        (0.70, 0.30, 0.22),
        (0.84, 0.76, 0.60),
        (0.28, 0.42, 0.40),
        (0.80, 0.58, 0.26),
    ]
    image = np.repeat(stripes(n, n / 50 * 1.6, rng, palette)[:, None], n, 1)
    for _ in range(260):
        flower(image, rng.uniform(0, n, 2), n / 50 * rng.uniform(0.3, 0.6), rng, palette)
    return np.clip(image * (1 + 0.06 * fractal((n, n), rng, 0.5)[..., None]), 0, 1)


def leather(n, rng, color, seams=()):
    """Worn leather; stitches along the heights `seams` in [0, 1]."""
    image = np.ones((n, n, 3)) * color * (1 + 0.22 * fractal((n, n), rng, 1.0)[..., None])
    y, x = np.mgrid[:n, :n] / n
    for seam in seams:
        over(image, (0.85, 0.72, 0.48), 0.8 * (((x * 40) % 1 < 0.55) & (np.abs(y - seam) < 0.03)))
    return np.clip(image, 0, 1)
