"""Native renders of a stress scene with numpy only: pictures, gradients, counts."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..raster import _native, header
from ..raster.gpu.choice import CPU, Chosen
from ..raster.gpu.gpu_raster import GpuRaster
from ..raster.gpu.header import GRADIENTS
from ..raster.request import Frustum, Settings
from ..shared_constants import EPS2D
from ..splats import PARAMETERS
from .case import Measure, UnsupportedMachineError
from .scenes import SplatScene

BACKGROUND = (0.25, 0.5, 0.125)
"""Exact in float32."""
PICTURES = ("rgb", "alpha", "inverse_depth", "depth")
ALL_DEPTHS = header.OUT_INVERSE_DEPTH | header.OUT_DEPTH | header.OUT_MEDIAN_DEPTH
ONLY_CPU = "measures the CPU only"
"""Reason of what is skipped on a graphics card."""
_GUARD = np.float32(-777.25)
_GUARD_WORDS = 64


class _DeviceStats(dict[str, float]):
    """Counts of a graphics card: using one that only the CPU has skips the rest of the case."""

    def __missing__(self, key: str) -> float:
        raise UnsupportedMachineError(f"{key}: {ONLY_CPU}")


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """Result of a forward call, and of a backward call if weights were given."""

    pictures: dict[str, np.ndarray]
    """rgb [H, W, 3], alpha, inverse_depth, depth (undivided sum of w z), median_depth [H, W]."""
    radii: np.ndarray
    """[N] int32, 0 = culled."""
    projected: dict[str, np.ndarray]
    """means2d, depths, conics, colors, opacities; zero rows where culled."""
    gradients: dict[str, np.ndarray]
    """Gradients by parameter, and means2d [N, 2], viewmat [4, 4]; empty without weights."""
    stats: dict[str, float]
    guards_broken: int
    """Words changed next to the output arrays of the library."""

    def bits(self) -> bytes:
        """Bytes of all pictures and gradients."""
        arrays = [*self.pictures.values(), *self.gradients.values(), self.radii]
        return b"".join(a.tobytes() for a in arrays)

    def finite(self) -> bool:
        """Whether all pictures and gradients are finite."""
        return all(
            np.isfinite(a).all() for a in (*self.pictures.values(), *self.gradients.values())
        )


class _Guarded:
    """Allocates arrays between guard words."""

    def __init__(self) -> None:
        self._whole: list[np.ndarray] = []

    def array(self, *shape: int) -> np.ndarray:
        size = int(np.prod(shape))
        whole = np.full(size + 2 * _GUARD_WORDS, _GUARD, np.float32)
        self._whole.append(whole)
        return whole[_GUARD_WORDS : _GUARD_WORDS + size].reshape(shape)

    def broken(self) -> int:
        return sum(
            int((w[:_GUARD_WORDS] != _GUARD).sum() + (w[-_GUARD_WORDS:] != _GUARD).sum())
            for w in self._whole
        )


def draw(
    scene: SplatScene,
    weights: dict[str, np.ndarray] | None = None,
    *,
    raw: bool = True,
    sh_degree: int | None = None,
    antialias: bool = False,
    near: float = 0.01,
    far: float = 1e10,
    eps2d: float = EPS2D,
    orthographic: bool = False,
    outputs: int = ALL_DEPTHS,
    disable: int = 0,
    threads: int = 2,
    background: tuple[float, float, float] = BACKGROUND,
) -> Drawn:
    """Render a scene, and differentiate sum(weights * pictures) if weights are given.

    Args:
        scene: Splats and camera.
        weights: By name of `PICTURES`; float32 arrays of the pictures' shapes.
        raw, sh_degree, antialias, near, far, eps2d, orthographic: as `gscore.render`.
        outputs: Bits of `header.OUT_*`.
        disable: Bits of `header.NO_*`.
        threads: Threads.
        background: Background RGB.
    """
    n, h, w = len(scene), scene.height, scene.width
    arrays = [np.ascontiguousarray(getattr(scene, name), np.float32) for name in PARAMETERS]
    memory = _Guarded()
    pictures = {"rgb": memory.array(h, w, 3)}
    pictures |= {k: memory.array(h, w) for k in ("alpha", "inverse_depth", "depth", "median_depth")}
    radii = np.zeros(n, np.int32)
    view = Frustum(scene.viewmat, scene.K, w, h, near, far, orthographic)
    settings = Settings(
        raw=raw,
        sh_degree=sh_degree,
        eps2d=eps2d,
        antialias=antialias,
        background=background,
        outputs=outputs | (GRADIENTS if weights is not None and draws_on_device() else 0),
        threads=threads,
        disable=disable,
    )
    gradients: dict[str, np.ndarray] = {}
    with workspace() as raster:
        raster.forward(arrays, view, settings, pictures | {"radii": radii})
        projected = raster.projected(n)
        if weights is not None:
            gradients = {
                name: memory.array(*a.shape) for name, a in zip(PARAMETERS, arrays, strict=True)
            }
            gradients |= {"means2d": memory.array(n, 2), "viewmat": memory.array(4, 4)}
            kept = {
                k: np.ascontiguousarray(weights[k], np.float32) for k in PICTURES if k in weights
            }
            raster.backward(arrays, view, settings, kept, gradients)
        stats = raster.stats()
        if isinstance(raster, GpuRaster):
            stats = _DeviceStats({name: stats[name] for name in ("visible", "entries")})
    kept_names = ["rgb", "alpha"]
    kept_names += ["inverse_depth"] if outputs & header.OUT_INVERSE_DEPTH else []
    kept_names += ["depth"] if outputs & header.OUT_DEPTH else []
    kept_names += ["median_depth"] if outputs & header.OUT_MEDIAN_DEPTH else []
    return Drawn(
        pictures={name: pictures[name] for name in kept_names},
        radii=radii,
        projected=projected,
        gradients=gradients,
        stats=stats,
        guards_broken=memory.broken(),
    )


def random_weights(scene: SplatScene, seed: int, *names: str) -> dict[str, np.ndarray]:
    """Weights of standard normal numbers for `draw`, for all pictures or those named."""
    rng = np.random.default_rng(seed)
    size = (scene.height, scene.width)
    made = {
        name: rng.normal(size=(*size, 3) if name == "rgb" else size).astype(np.float32)
        for name in PICTURES
    }
    return {name: made[name] for name in names or PICTURES}


def only_cpu(what: str) -> Measure:
    """A measure that is skipped on a graphics card."""
    return Measure(what, math.nan, math.nan, ONLY_CPU, skipped=True)


_chosen = CPU
opened: list[Any] = []
"""Engines of a case on a graphics card, which are closed behind it."""


def draws_on_device() -> bool:
    """Whether `draw` uses a graphics card."""
    return _chosen.device is not None


def open_engine() -> Any:
    """An `Engine` of what draws; imported late because it loads torch."""
    from ..engine.opening import engine_of

    engine = engine_of(_chosen)
    opened.append(engine)
    return engine


@contextmanager
def workspace() -> Iterator[_native.Raster | GpuRaster]:
    """Context with what draws: a new workspace of the CPU, or the device."""
    if not draws_on_device():
        yield _native.Raster()
        return
    with _chosen.lend() as raster:
        yield raster


@contextmanager
def with_device(chosen: Chosen) -> Iterator[None]:
    """Context in which `draw`, `workspace` and `open_engine` use a device."""
    global _chosen
    before, _chosen = _chosen, chosen
    try:
        yield
    finally:
        _chosen = before
        while opened:
            opened.pop().close()


@contextmanager
def with_isa(name: str) -> Iterator[None]:
    """Context in which the library uses an instruction set."""
    before = _native.isa()
    _native.set_isa(name)
    try:
        yield
    finally:
        _native.set_isa(before)
