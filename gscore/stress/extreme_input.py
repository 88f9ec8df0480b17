"""S10 to S12, extreme input: very large or small quats, opacities and scales; one broken row."""

from collections.abc import Iterator

import numpy as np

from ..splats import PARAMETERS
from . import native, truth
from .case import EmptyTestError, Measure, case
from .compare import different_bits, gradient_measures, picture_measures, require_covered
from .scenes import SplatScene, draw_scene


def _without(scene: SplatScene, row: int) -> np.ndarray:
    return np.arange(len(scene)) != row


@case("S10", "quaternions of any length", needs=())
def quaternions(full: bool) -> Iterator[Measure]:
    """Oracle: the scene without the row; the scene with normal quaternions."""
    scene = draw_scene(1000, count=200, width=48, height=40)
    weights = native.random_weights(scene, 1)
    plain = native.draw(scene, weights)
    require_covered(plain.pictures["alpha"])
    row = int(np.argmax(plain.radii * (np.abs(plain.gradients["quats"]).sum(1) > 0)))
    keep = _without(scene, row)
    gone = native.draw(scene.rows(keep), weights)
    if different_bits(plain.pictures, gone.pictures) == 0:
        raise EmptyTestError("the damaged row was not visible")
    for name, quat in (
        ("zero", [0, 0, 0, 0]),
        ("1e-20", [1e-20, 0, 0, 0]),
        ("1e-9", [0, 1e-9, 0, 0]),
    ):
        dead = native.draw(scene.with_row(row, quats=quat), weights)
        changed = different_bits(dead.pictures, gone.pictures)
        changed += int(np.count_nonzero(dead.gradients["quats"][row])) + int(dead.radii[row])
        yield Measure(f"length {name}, trace of a dead row", float(changed), 0)
    flipped = native.draw(scene.with_row(slice(None), quats=-scene.quats), weights)
    changed = different_bits(flipped.pictures, plain.pictures)
    changed += int((flipped.gradients["quats"] != -plain.gradients["quats"]).sum())
    yield Measure("-q, bits changed", float(changed), 0)
    for name, factor in (("x 10", 10.0), ("x 1e-6", 1e-6), ("x 1e20", 1e20), ("x 1e37", 1e37)):
        longer = scene.with_row(slice(None), quats=scene.quats * np.float32(factor))
        drawn = native.draw(longer, weights)
        errors = [np.abs(drawn.pictures[k] - plain.pictures[k]).max() for k in ("rgb", "alpha")]
        yield Measure(f"{name}, picture", float(np.max(errors)), 1e-6)
        yield Measure("numbers not finite", float(not drawn.finite()), 0)


@case("S11", "opacities at their ends")
def opacities(full: bool) -> Iterator[Measure]:
    """Oracle: the reference; alpha at most 0.99 per splat; transmittance never negative."""
    scene = draw_scene(1100, count=200, width=48, height=40, sigma_px=(4.0, 10.0), sh_degree=1)
    values = np.array([-1000.0, -20.0, 20.0, 1000.0, 0.0], np.float32)
    scene = scene.with_row(slice(None), opacities=np.resize(values, 200))
    true = truth.reference_truth(scene)
    drawn = native.draw(scene, true.weights)
    # Splats of opacity 1 are wide where alpha is capped, and half the splats are opaque here.
    yield from picture_measures(drawn, true)
    yield from gradient_measures(drawn, true)
    yield Measure("numbers not finite", float(not drawn.finite()), 0)

    stack = draw_scene(1101, count=200, width=32, height=24, sigma_px=(40.0, 80.0), posed=False)
    stack = stack.with_row(slice(None), opacities=20.0)
    layers = native.draw(stack, native.random_weights(stack, 1))
    light = 1 - layers.pictures["alpha"]
    require_covered(layers.pictures["alpha"])
    yield Measure("200 layers, light below 0", float(max(0.0, -light.min())), 0)
    yield Measure("200 layers, light above 1e-2", float(max(0.0, light.max() - 0.0101)), 0)
    yield Measure("numbers not finite", float(not layers.finite()), 0)
    one = native.draw(stack.rows(slice(0, 1)), outputs=0)
    cap = float(one.pictures["alpha"].max())
    yield Measure("alpha of one opaque splat", abs(cap - 0.99), 1e-7)


_BROKEN = (float("nan"), float("inf"), float("-inf"))
_EXTREME = (
    -40.0,
    40.0,
    3.4028235e38,
    -3.4028235e38,
    1e-40,
    -1e-40,
    1 / 255,
    16.0,
    0.0,
    88.8,
    -104.0,
)


@case("S12", "one broken row in a thousand", needs=())
def broken_row(full: bool) -> Iterator[Measure]:
    """Oracle: the scene without the row, pictures and the other rows' gradients bit for bit."""
    count = 1000
    scene = draw_scene(1200, count=count, width=48, height=40, sigma_px=(0.7, 3.0), sh_degree=2)
    weights = native.random_weights(scene, 1)
    plain = native.draw(scene, weights)
    require_covered(plain.pictures["alpha"])
    row = int(np.argmax(plain.radii))
    keep = _without(scene, row)
    gone = native.draw(scene.rows(keep), weights)
    if different_bits(plain.pictures, gone.pictures) == 0:
        raise EmptyTestError("the damaged row was not visible")
    touched = drawn_anyway = not_finite = culled_but_touched = extremes_drawn = 0
    for field in PARAMETERS:
        for column in range(3 if field in ("means", "quats", "scales") else 1):
            for value in _BROKEN + _EXTREME:
                array = np.array(getattr(scene, field)[row])
                array.reshape(-1)[column] = value
                bad = native.draw(scene.with_row(row, **{field: array}), weights)
                others = {k: bad.gradients[k][keep] for k in PARAMETERS}
                differs = different_bits(bad.pictures, gone.pictures)
                differs += different_bits(others, {k: gone.gradients[k] for k in PARAMETERS})
                if value in _EXTREME:
                    not_finite += not bad.finite()
                    extremes_drawn += int(bad.radii[row] > 0)
                    culled_but_touched += differs if bad.radii[row] == 0 else 0
                else:
                    touched += differs
                    left = any(bad.gradients[k][row].any() for k in PARAMETERS)
                    drawn_anyway += int(bad.radii[row] > 0) + int(left)
    if extremes_drawn < 10:
        raise EmptyTestError(f"only {extremes_drawn} of the extreme values leave a visible splat")
    yield Measure("NaN and infinities, bits changed elsewhere", float(touched), 0)
    yield Measure("NaN and infinities, rows drawn", float(drawn_anyway), 0)
    yield Measure("finite extremes, scenes not finite", float(not_finite), 0)
    yield Measure("finite extremes, culled yet seen", float(culled_but_touched), 0)


@case("S12b", "every row extreme at once", needs=())
def all_extreme(full: bool) -> Iterator[Measure]:
    """Oracle: finiteness, with random extreme values in all splats."""
    values = np.array(_BROKEN + _EXTREME + (1.0, -1.0, 0.5, 2.0), np.float32)
    bad = visible = 0
    # The last seeds: coefficients of 3e38 where a basis function is zero but its slope is not.
    for seed in range(200) if full else (*range(16), 116, 136, 150, 162):
        rng = np.random.default_rng(1250 + seed)
        scene = draw_scene(seed, count=60, width=24, height=20, posed=bool(seed % 2))
        changed = {}
        for field in PARAMETERS:
            array = getattr(scene, field).copy()
            hit = rng.random(array.shape) < 0.15
            array[hit] = rng.choice(values, hit.sum())
            changed[field] = array
        scene = scene.with_row(slice(None), **changed)
        drawn = native.draw(scene, native.random_weights(scene, 1), antialias=bool(seed % 3))
        bad += not drawn.finite()
        visible += int(drawn.stats["visible"])
    if not visible > 10:
        raise EmptyTestError("nothing was drawn")
    yield Measure("scenes not finite", float(bad), 0)
