"""S25, antialias: opacity compensation of splats far below a pixel."""

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from . import native, truth
from .case import EmptyTestError, Measure, case
from .compare import gradient_measures, picture_measures
from .scenes import SplatScene, draw_scene
from .truth import Truth


def _seen_by(scene: SplatScene, others: SplatScene) -> SplatScene:
    """Splats in camera coordinates, moved to the world of `scene`."""
    means = (others.means - scene.viewmat[:3, 3]) @ scene.viewmat[:3, :3]
    return others.with_row(slice(None), means=means)


@lru_cache(maxsize=8)
def _dots(low: float, high: float, logits: tuple[float, float]) -> tuple[SplatScene, Truth]:
    scene = draw_scene(
        2500, count=1500, width=32, height=28, sigma_px=(low, high), logits=logits, sh_degree=0
    )
    back = draw_scene(2503, count=40, width=32, height=28, sh_degree=0, posed=False)
    scene = scene.joined(_seen_by(scene, back))
    return scene, truth.reference_truth(scene, antialias=True)


@case("S25", "anti-aliased dots")
def dots(full: bool) -> Iterator[Measure]:
    """Oracle: the reference, whose gradient passes through the factor above its floor."""
    for name, low, high in (("0.15 to 0.6 px", 0.15, 0.6), ("1e-3 to 0.5 px", 1e-3, 0.5)):
        # Splats with high opacity, and a backdrop that fills the picture.
        scene, true = _dots(low, high, (3.0, 6.0))
        drawn = native.draw(scene, true.weights, antialias=True)
        factor = true.projected["opacities"] * (1 + np.exp(-scene.opacities.astype(np.float64)))
        if not (factor[factor > 0] < 0.5).any():
            raise EmptyTestError("nothing is compensated")
        for m in (*picture_measures(drawn, true), *gradient_measures(drawn, true)):
            yield Measure(f"{name}, {m.what}", m.error, m.tolerance, m.note)
        yield Measure("numbers not finite", float(not drawn.finite()), 0)
    tiny = draw_scene(
        2501, count=400, width=32, height=28, sigma_px=(1e-9, 1e-4), logits=(5.0, 9.0)
    )
    big = draw_scene(2502, count=60, width=32, height=28, posed=False)
    floor = tiny.joined(_seen_by(tiny, big))
    drawn = native.draw(floor, native.random_weights(floor, 1), antialias=True)
    yield Measure("numbers not finite", float(not drawn.finite()), 0)
