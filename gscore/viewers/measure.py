"""Measurement of splats as viewers show them: PSNR to photos and difference to gscore's picture."""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from ..events import headline_psnr
from ..metrics import evaluate
from ..photo_exposure import NEUTRAL, PhotoExposure
from ..raster.reference.rasterize import SplatTensors
from ..raster.request import Frustum
from .picture import modelled_picture
from .rules import ViewerRules


def measured(
    models: Mapping[str, SplatTensors],
    viewers: Iterable[ViewerRules],
    dataset: Any,
    views: Mapping[int, Frustum],
    own: Mapping[int, np.ndarray],
    exposures: Mapping[str, PhotoExposure],
    *,
    background: tuple[float, float, float],
    on_picture: Callable[[], None],
) -> tuple[dict[str, float | None], dict[str, dict[str, dict[str, float | None]]]]:
    """Measure models in viewers, by `modelled_picture`, against photos and gscore's own pictures.

    Args:
        models: Raw parameters by name.
        viewers: Rules.
        dataset: The photos, as for `gscore.metrics.evaluate`.
        views: Cameras by their index in the dataset.
        own: [H, W, 3] pictures of gscore with the exposure of the photo, by index.
        exposures: By photo; photos without one have the mean exposure.
        background: sRGB.
        on_picture: Called after each modelled picture; may raise.

    Returns:
        `psnr` of gscore's own pictures, dB; and by viewer and model, `psnr`, dB, and `difference`,
        the mean absolute difference of the pictures before exposure, of 255. None: infinite or not
        measurable.
    """
    names = dataset.scene.cameras.names
    exposed = {index: exposures.get(names[index], NEUTRAL) for index in views}
    behind = dict.fromkeys(views, background)
    if dataset.mask_mode == "composite":  # the background of the photos has no exposure
        behind = {index: exposure.behind(background) for index, exposure in exposed.items()}

    def one(splats: SplatTensors, rules: ViewerRules) -> dict[str, float | None]:
        differences: list[float] = []
        pictures = {}
        for index, view in views.items():
            pictures[index] = modelled_picture(splats, view, rules, behind[index]).numpy()
            target = np.clip(exposed[index].undo(own[index]), 0, 1)
            differences.append(255 * float(np.abs(pictures[index] - target).mean()))
            on_picture()
        shown = {index: exposed[index].apply(picture) for index, picture in pictures.items()}
        scored = evaluate(shown.__getitem__, dataset, views, background=background)
        return {
            "psnr": headline_psnr(scored.mean),
            "difference": math.fsum(differences) / len(differences),
        }

    found = {
        rules.name: {name: one(splats, rules) for name, splats in models.items()}
        for rules in viewers
    }
    scored = evaluate(own.__getitem__, dataset, views, background=background)
    return {"psnr": headline_psnr(scored.mean)}, found


def strided(indices: list[int], count: int) -> list[int]:
    """At most `count` of the indices, from the first on, with a constant stride."""
    step = max(1, -(-len(indices) // max(count, 1)))
    return indices[::step]
