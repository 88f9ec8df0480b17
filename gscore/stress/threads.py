"""S15, S18 to S20, S31, equal bits: row order, skips, threads, ISAs and the host's rounding."""

import ctypes
import ctypes.util
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from ..raster import _native, header, native_library
from ..splats import PARAMETERS
from . import native, truth
from .case import EmptyTestError, Measure, UnsupportedMachineError, case
from .compare import different_bits, picture_errors, require_covered
from .native import Drawn, with_isa
from .scenes import SplatScene, draw_scene

_THREADS = (2, 3, 8, 64)


def _scene(seed: int, full: bool) -> SplatScene:
    return draw_scene(
        seed,
        count=6000 if full else 3000,
        width=150,
        height=100,
        focal=(120.0, 120.0),
        sigma_px=(0.8, 5.0),
        overscan=0.1,
    )


@case("S18", "any number of threads", needs=())
def thread_counts(full: bool) -> Iterator[Measure]:
    """Oracle: one thread; pictures and gradients bit for bit, twice over."""
    scene = _scene(1800, full)
    weights = native.random_weights(scene, 1)
    one = native.draw(scene, weights, threads=1)
    require_covered(one.pictures["alpha"])
    changed = 0
    for threads in (*_THREADS, *(range(1, 65) if full else ()), 1, 2):
        many = native.draw(scene, weights, threads=threads)
        changed += different_bits(one.pictures, many.pictures)
        changed += different_bits(one.gradients, many.gradients)
    yield Measure("bits changed", float(changed), 0)


@case("S19", "instruction sets against each other", per_isa=False)
def instruction_sets(full: bool) -> Iterator[Measure]:
    """Oracle: the best available instruction set, outside the band of the reference."""
    from . import truth

    isas = native_library.available_isas()
    if len(isas) < 2:
        raise UnsupportedMachineError(f"this machine has one instruction set, {isas[0]}")
    for seed in range(1900, 1905 if full else 1902):
        scene = draw_scene(seed, count=500, width=64, height=48, overscan=0.1)
        true = truth.reference_truth(scene)
        require_covered(true.pictures["alpha"])
        drawn: dict[str, Drawn] = {}
        for isa in isas:
            with with_isa(isa):
                drawn[isa] = native.draw(scene, true.weights)
        best = drawn[isas[0]]
        for isa in isas[1:]:
            # Without fused multiply-add the errors differ, by 1e-6 from the truth.
            tolerance = 2e-6 if isa == "scalar" else 1e-6
            for name, picture in drawn[isa].pictures.items():
                if name == "median_depth":
                    continue  # selects one splat by a comparison that rounding can change
                scale = max(1.0, float(np.abs(true.pictures[name]).max()))
                error = np.abs(picture - best.pictures[name])[~true.band].max() / scale
                yield Measure(f"{isas[0]} and {isa}, picture", float(error), tolerance)
            errors = [
                np.abs(g - best.gradients[k]).max() / np.abs(best.gradients[k]).max()
                for k, g in drawn[isa].gradients.items()
            ]
            yield Measure(f"{isas[0]} and {isa}, gradient", float(np.max(errors)), 1e-5)


_THIRD = np.float32(1) / np.float32(3)
"""Rounded to nearest, as the interpreter starts."""
_ROUNDINGS = {"x86_64": (0x000, 0x400, 0x800, 0xC00), "aarch64": (0, 0x800000, 0x400000, 0xC00000)}
"""glibc's numbers of the modes: to nearest first; then down, up and to zero in any order."""


@contextmanager
def _rounding_calls(libm: ctypes.CDLL, mode: int, seen: list[tuple[bool, bool]]) -> Iterator[None]:
    """Context that sets the mode only around calls of the library, since the preparation of
    arguments rounds too.

    Each call appends to `seen` whether the mode was effective before it and lost after it.
    """

    def wrapped(call: Any) -> Any:
        def inside(*args: Any) -> int:
            if libm.fesetround(mode) != 0:
                raise UnsupportedMachineError("the rounding mode cannot be set")
            try:
                effect = bool(np.float32(1) / np.float32(3) != _THIRD)
                status = call(*args)
                seen.append((effect, libm.fegetround() != mode))
                return status
            finally:
                libm.fesetround(0)

        return inside

    library = _native.library()
    kept = {name: getattr(library, name) for name in ("gs_raster_forward", "gs_raster_backward")}
    for name, call in kept.items():
        setattr(library, name, wrapped(call))
    try:
        yield
    finally:
        for name, call in kept.items():
            setattr(library, name, call)


@case("S20", "the host's rounding mode", needs=())
def rounding(full: bool) -> Iterator[Measure]:
    """Oracle: the default environment; the mode must be unchanged afterwards."""
    import platform

    modes = _ROUNDINGS.get(platform.machine())
    if not sys.platform.startswith("linux") or modes is None:
        raise UnsupportedMachineError("setting the rounding mode needs Linux on x86-64 or ARM64")
    libm = ctypes.CDLL(ctypes.util.find_library("m") or "libm.so.6")
    scene = _scene(2000, full=False)
    weights = native.random_weights(scene, 1)
    plain = native.draw(scene, weights)
    require_covered(plain.pictures["alpha"])
    pictures: list[float] = []
    gradients: list[float] = []
    lost = differs = 0
    for mode in modes[1:]:
        seen: list[tuple[bool, bool]] = []
        with _rounding_calls(libm, mode, seen):
            drawn = native.draw(scene, weights)
        if len(seen) != 2:
            raise EmptyTestError("the library was not called")
        differs += seen[0][0]  # down and to zero move a third, up does not
        lost += sum(bad for _, bad in seen)
        for name, p in plain.pictures.items():
            pictures.append(float(np.abs(drawn.pictures[name] - p).max()))
        for name, g in plain.gradients.items():
            gradients.append(float(np.abs(drawn.gradients[name] - g).max() / np.abs(g).max()))
    if not differs:
        raise EmptyTestError("the rounding mode has no effect here")
    yield Measure("picture", float(np.max(pictures)), 1e-7)
    yield Measure("gradient", float(np.max(gradients)), 1e-7)
    yield Measure("modes not restored", float(lost), 0)


def _layers(count: int, depths: int, sigma_px: tuple[float, float]) -> SplatScene:
    """Splats at `depths` different depths near 3, which are projected without rounding."""
    scene = draw_scene(
        1500, count=count, posed=False, width=48, height=40, sh_degree=0, sigma_px=sigma_px
    )
    means = scene.means.copy()
    z = 3 + np.random.default_rng(2).integers(depths, size=(count, 1)).astype(np.float32) / 256
    means[:, :2] *= z / means[:, 2:]
    means[:, 2:] = z
    return scene.with_row(slice(None), means=means)


@case("S15", "splats at one depth", on_device=True)
def ties(full: bool) -> Iterator[Measure]:
    """Oracle: the reference, which sorts stably: at equal depth, the order of the rows decides."""
    # Different sorting algorithms: a few splats, many, and many with some ties.
    for name, count, depths, sigmas in (
        ("all", 1000, 1, (1.5, 5.0)),
        ("a short list", 20, 1, (5.0, 12.0)),
        ("in layers", 1000, 100, (1.5, 5.0)),
    ):
        scene = _layers(count, depths, sigmas)
        pictures = []
        for one in (scene, scene.rows(np.random.default_rng(1).permutation(count))):
            # Ties put pixels into the band, which does not matter without rounding in z.
            true = truth.reference_truth(one, gradients=False)
            drawn = native.draw(one)
            require_covered(true.pictures["alpha"])
            errors = picture_errors(drawn, true)
            rough = float(np.quantile(errors, 0.99))
            yield Measure(f"{name}, picture, 99 % of the pixels", rough, 1e-5, "all pixels tie")
            pictures.append(drawn.pictures["rgb"])
        if not np.abs(pictures[0] - pictures[1]).max() > 0.05:
            raise EmptyTestError(f"{name}: the order of the rows makes no difference here")
    apart = draw_scene(1501, count=1000, width=48, height=40, sh_degree=0)
    if len(np.unique(native.draw(apart).projected["depths"])) < 990:
        raise EmptyTestError("depths repeat")
    shuffled = np.random.default_rng(1).permutation(1000)
    one, other = native.draw(apart), native.draw(apart.rows(shuffled))
    yield Measure(
        "distinct depths shuffled, bits changed",
        float(different_bits(one.pictures, other.pictures)),
        0,
    )


@case("S31", "tiles without a gradient", needs=())
def zero_tiles(full: bool) -> Iterator[Measure]:
    """Oracle: the backward pass over all tiles, gradients bit for bit."""
    changed = skipped = 0
    for seed in range(20 if full else 4):
        scene = draw_scene(3100 + seed, count=300, width=96, height=80, overscan=0.1)
        weights = native.random_weights(scene, seed)
        rng = np.random.default_rng(seed)
        mask = np.kron(rng.random((5, 6)) < 0.4, np.ones((16, 16))).astype(np.float32)
        # All non-zero values count, also denormal ones; a zero may have a sign.
        faint = np.kron(rng.choice([1, 1e-30, 1e-42, -1], (5, 6)), np.ones((16, 16)))
        mask *= faint.astype(np.float32)
        masked = {k: w * (mask[..., None] if w.ndim == 3 else mask) for k, w in weights.items()}
        for background in (native.BACKGROUND, tuple(rng.random(3).tolist())):
            fast = native.draw(scene, masked, background=background)
            slow = native.draw(scene, masked, background=background, disable=header.NO_ZERO_TILE)
            require_covered(fast.pictures["alpha"])
            changed += different_bits(fast.gradients, slow.gradients)
            skipped += fast.stats["backward_pairs"] < slow.stats["backward_pairs"]
            if not any(fast.gradients[k].any() for k in PARAMETERS):
                raise EmptyTestError("all gradients are zero")
    if not skipped:
        raise EmptyTestError("no tile was skipped")
    yield Measure("gradient bits changed by skipping", float(changed), 0)
