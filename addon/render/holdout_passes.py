"""Holdout passes: data with which the compositor cuts meshes and the world at holdouts.

`HOLDOUT` is the share of light that holdout splats block by themselves. `HOLDOUT_BEHIND` is the
share of the background to remove, beyond the picture's alpha. `HOLDOUT_DEPTH` is the depth of the
holdout splats; *Depth* is then that of the other splats. `MESHES` is the film's pass of holdout
meshes, and `HOLDOUT_EDGE` the picture's alpha in the part of a pixel that those meshes leave
free.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .color import NOTHING
from .pass_renderer import MESHES, SHARE, Film
from .shutter_lens import View

HOLDOUT, HOLDOUT_BEHIND, HOLDOUT_DEPTH = "Holdout", "Holdout Behind", "Holdout Depth"
HOLDOUT_EDGE = "Holdout Beside"
NAMES = HOLDOUT, HOLDOUT_BEHIND, HOLDOUT_DEPTH, MESHES, HOLDOUT_EDGE
"""Names of the passes, in their order."""
_FULL = 1e-4
"""Transmittance below which the background is taken as hidden."""
_PART = 1 / 16
"""Least part of a pixel that gets its own alpha; smaller ones are unreliable in lens means."""

Stop = Callable[[], bool]


def blocked(film: Film, view: View, stop: Stop) -> dict[str, np.ndarray]:
    """The light that splats block, [H, W] float32, the bottom row first: by holdouts as `HOLDOUT`,
    by all splats as `HOLDOUT_BEHIND`; empty without holdouts.

    Args:
        film: A transparent film.
        view: The model and its camera.
        stop: As `Film.render`.
    """
    if view.model.shares is None:
        return {}
    whole = replace(view, model=replace(view.model, shares=None))
    shown = {HOLDOUT: _only(view, holdout=True), HOLDOUT_BEHIND: whole}
    plain = film.without_depths()
    return {name: plain.render(v, stop)["Combined"][..., 3].copy() for name, v in shown.items()}


def depths(film: Film, view: View, stop: Stop) -> dict[str, np.ndarray]:
    """The passes *Depth* and `HOLDOUT_DEPTH`; arguments and result as `blocked`."""
    if view.model.shares is None:
        return {}
    shown = {"Depth": _only(view, holdout=False), HOLDOUT_DEPTH: _only(view, holdout=True)}
    return {name: film.render(v, stop)["Depth"] for name, v in shown.items()}


def completed(found: dict[str, np.ndarray], shot: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """All passes.

    Args:
        found: Results of `blocked`, or their means, and of `depths`.
        shot: Passes of the film, or their means.
    """
    picture = shot["Combined"]
    nothing = np.zeros(picture.shape[:2], np.float32)
    meshes, share = (shot.get(n, nothing).reshape(nothing.shape) for n in (MESHES, SHARE))
    found = {MESHES: meshes, HOLDOUT_EDGE: _edge_alpha(picture[..., 3], meshes, share), **found}
    if HOLDOUT not in found:
        far = np.full_like(nothing, NOTHING)
        return {**found, HOLDOUT: nothing, HOLDOUT_BEHIND: nothing, HOLDOUT_DEPTH: far}
    light, left = 1 - found[HOLDOUT_BEHIND], 1 - picture[..., 3]
    kept = np.divide(light, left, out=np.zeros_like(light), where=left > _FULL)
    return {**found, HOLDOUT_BEHIND: 1 - np.clip(kept, 0, 1)}


def _edge_alpha(alpha: np.ndarray, meshes: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Alpha in the part of each pixel outside holdout meshes, or of the whole pixel where they
    cover all. At least the whole pixel's alpha, because the meshes hide splats behind them."""
    more = (meshes - share * (1 - alpha)) / np.maximum(1 - share, _PART)
    return np.clip(alpha + more, alpha, np.maximum(alpha, 1))


def _only(view: View, *, holdout: bool) -> View:
    """The view with holdout splats only, or without them."""
    owners, counts = zip(*view.model.owners, strict=True)
    cuts = np.repeat([owner is None for owner in owners], counts)
    splats = view.model.splats.subset(cuts == holdout)
    return replace(view, model=replace(view.model, splats=splats, shares=None, owners=()))
