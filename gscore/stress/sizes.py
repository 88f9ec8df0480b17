"""S13, S14, S16, S17, S29, sizes: extremes of counts, resolutions and splat sizes.

S10 to S12: very large or small quats, opacities and scales; one broken row.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..raster import header
from ..splats import PARAMETERS
from ..text_format import count_text, number
from . import native, truth
from .case import EmptyTestError, Measure, case
from .compare import INTERIOR, different_bits, gradient_measures, picture_measures, require_covered
from .scenes import SplatScene, draw_scene

_ENTRY_BYTES = 512
"""Maximum workspace per (tile, splat) entry with gradients: lists, copies and sums, bytes."""


def _list_tiles(width: int, height: int) -> int:
    wide, high = (header.TILE, header.TILE) if native.draws_on_device() else header.LIST_TILE
    return -(-width // wide) * -(-height // high)


@case("S13", "screen-filling splats", on_device=True)
def screen_filling(full: bool) -> Iterator[Measure]:
    """Oracle: every splat in every tile and no more; the reference for the picture."""
    count, width, height = 1000, 64, 48
    scene = draw_scene(
        1300, count=count, width=width, height=height, sigma_px=(100.0, 400.0), logits=(-5.4, -5.2)
    )
    weights = native.random_weights(scene, 1)
    drawn = native.draw(scene, weights)
    tiles = _list_tiles(width, height)
    seen = int(drawn.stats["visible"])
    if seen < 900:
        raise EmptyTestError(f"only {seen} of {count_text(count, 'splat')} fill the picture")
    # Opacity 0.0045 to 0.0055 with a cutoff of 0.0039: not every splat fills the whole picture.
    yield Measure(
        "entries beyond tiles x splats", max(0.0, drawn.stats["entries"] - tiles * seen), 0
    )
    if native.draws_on_device():
        yield native.only_cpu("workspace bytes an entry")
    else:
        size = drawn.stats["workspace_bytes"] / (tiles * count)
        yield Measure("workspace bytes an entry", size, _ENTRY_BYTES)
    few = scene.rows(slice(0, count if full else 150))
    true = truth.reference_truth(few, gradients=False)
    # So faint and wide that the cutoff at 1/255 affects large parts of the picture. A thousand
    # layers at a pixel round transmittance and colour a thousand times.
    mean = 1e-6 if full else None
    yield from picture_measures(native.draw(few), true, mean=mean, most_band=0.9)

    big = draw_scene(1301, count=1, width=3840, height=2160, focal=(3000.0, 3000.0), posed=False)
    big = big.with_row(0, means=[0, 0, 2.0], scales=[2.0] * 3, opacities=2.0)
    one = native.draw(big, {"rgb": np.ones((2160, 3840, 3), np.float32)})
    require_covered(one.pictures["alpha"])
    tiles = _list_tiles(3840, 2160)
    yield Measure("one splat over 4K, entries", abs(one.stats["entries"] - tiles), 0)
    yield Measure("numbers not finite", float(not (drawn.finite() and one.finite())), 0)


@case("S14", "a tile with thousands of splats", on_device=True)
def crowded_tile(full: bool) -> Iterator[Measure]:
    """Oracle: the reference; more splats in one tile than 11 and than 16 bits count."""
    for count in (3000, 70_000) if full else (3000,):
        scene = draw_scene(
            1400,
            count=count,
            width=16,
            height=16,
            focal=(20.0, 20.0),
            sigma_px=(0.02, 0.1),
            logits=(-5.2, -4.8) if count > 10_000 else (-4.4, -3.5),
            sh_degree=0,
        )
        true = truth.reference_truth(scene)
        drawn = native.draw(scene, true.weights)
        if drawn.stats["entries"] < 0.7 * count:
            raise EmptyTestError(
                f"only {drawn.stats['entries']:.0f} of {number(count)} splats are in the tile"
            )
        stopped = 1 - true.pictures["alpha"] < 2e-4
        if stopped.any():
            raise EmptyTestError("light does not reach the last splats")
        for m in (
            # With thousands of splats at a pixel, one is always near the cutoff.
            *picture_measures(drawn, true, most_band=0.999 if count > 10_000 else 0.5),
            *gradient_measures(drawn, true),
        ):
            yield replace(m, what=f"{count_text(count, 'splat')}, {m.what}")


@case("S16", "pictures of all sizes", on_device=True)
def picture_sizes(full: bool) -> Iterator[Measure]:
    """Oracle: the reference.

    Float32 has steps of 2.4e-4 px at 4096 px, and splats of 5 px a slope of 0.1 a px: sides beyond
    1024 px have tolerances in proportion.
    """
    sizes = [(1, 1), (1, 37), (37, 1), (15, 17), (16, 32), (17, 33), (32, 31), (513, 16)]
    for width, height in [*sizes, (4096, 16), (16, 4096)] if full else sizes:
        scene = draw_scene(
            1600 + width,
            count=60 if max(width, height) < 100 else 400,
            width=width,
            height=height,
            focal=(0.8 * width + 8, 0.8 * width + 8),
            overscan=0.3,
            sh_degree=1,
            sigma_px=(2.0, 5.0) if max(width, height) < 100 else (5.0, 40.0),
        )
        true = truth.reference_truth(scene)
        drawn = native.draw(scene, true.weights)
        tolerance = INTERIOR * max(1.0, max(width, height) / 1024)
        yield from picture_measures(drawn, true, tolerance=tolerance, most_band=0.5)
        yield from gradient_measures(drawn, true)


@case("S17", "nothing to draw", on_device=True, needs=())
def empty_scenes(full: bool) -> Iterator[Measure]:
    """Oracle: the background, exactly, and gradients of zero."""
    scene = draw_scene(1700, count=5)
    behind = draw_scene(1700, count=5, depths=(-6.0, -1.0))
    faint = scene.with_row(slice(None), opacities=-8.0)
    outside = scene.with_row(slice(None), means=scene.means + np.float32(1e6))
    changed = 0
    for one in (scene.rows(slice(0, 0)), behind, faint, outside):
        drawn = native.draw(one, native.random_weights(one, 1))
        changed += int((drawn.pictures["rgb"] != np.array(native.BACKGROUND, np.float32)).sum())
        changed += sum(np.count_nonzero(drawn.pictures[k]) for k in ("alpha", "depth"))
        changed += sum(np.count_nonzero(g) for g in drawn.gradients.values())
        changed += int(drawn.stats["visible"] != 0)
    full_picture = native.draw(scene, native.random_weights(scene, 1))
    require_covered(full_picture.pictures["alpha"])  # else the test above could not fail
    yield Measure("pixels and gradients that are not empty", float(changed), 0)


@case("S29", "nothing written beside the arrays, skips exact", on_device=True, needs=())
def guards(full: bool) -> Iterator[Measure]:
    """Oracle: guard words; the same call with all skips disabled, bit for bit."""
    broken = changed = fewer = 0
    for seed in range(30 if full else 6):
        scene = draw_scene(
            2900 + seed,
            count=50 * (seed + 1),
            width=17 + 13 * seed,
            height=40 - seed,
            overscan=0.4,
            elongation=float(seed % 3) * 1.5,
            sigma_px=(0.5, 6.0),
        )
        weights = native.random_weights(scene, 1)
        drawn = native.draw(scene, weights)
        require_covered(drawn.pictures["alpha"])
        broken += drawn.guards_broken
        off = header.NO_EXACT_CULL | header.NO_ZERO_TILE
        off |= header.NO_OPACITY_EXTENT | header.NO_ROW_RANGE
        if native.draws_on_device():
            continue
        plain = native.draw(scene, weights, disable=off)
        broken += plain.guards_broken
        changed += sum(int((drawn.pictures[k] != plain.pictures[k]).sum()) for k in drawn.pictures)
        fewer += drawn.stats["forward_pairs"] < plain.stats["forward_pairs"]
    yield Measure("guard words overwritten", float(broken), 0)
    if native.draws_on_device():
        yield native.only_cpu("pixels changed by skipping")
        return
    if not fewer:
        raise EmptyTestError("nothing was skipped")
    yield Measure("pixels changed by skipping", float(changed), 0)


def _without(scene: SplatScene, row: int) -> np.ndarray:
    return np.arange(len(scene)) != row


@case("S10", "quaternions of any length", on_device=True, needs=())
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


@case("S11", "opacities at their ends", on_device=True)
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


@case("S12", "one broken row in a thousand", on_device=True, needs=())
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


@case("S12b", "every row extreme at once", on_device=True, needs=())
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
