"""Measurements of viewers' pictures."""

import math
from types import SimpleNamespace

import numpy as np

from gscore.photo_exposure import PhotoExposure
from gscore.shared_constants import ALPHA_MIN
from gscore.viewers.measure import measured
from gscore.viewers.picture import modelled_picture
from gscore.viewers.rules import ViewerRules

PLAIN = ViewerRules(name="plain", label="", source="", reach=math.inf, alpha_min=ALPHA_MIN)


def test_a_composited_background_has_no_exposure(splats, view):
    """Oracle: gscore's own picture over white, whose splats alone are exposed as the photo; by its
    own rules there is no difference. Alike without masks, where the background is exposed too."""
    exposure = PhotoExposure.of([0.8, 0.9, 0.7])
    white = (1.0, 1.0, 1.0)
    for mode, behind in (("composite", exposure.behind(white)), ("none", white)):
        own = exposure.apply(modelled_picture(splats, view, PLAIN, behind).numpy())
        photo = (np.clip(own, 0, 1) * 255 + 0.5).astype(np.uint8)
        dataset = SimpleNamespace(
            scene=SimpleNamespace(cameras=SimpleNamespace(names=["a"])),
            mask_mode=mode,
            image=lambda index, photo=photo: photo,
            mask=lambda index: None,
        )
        _, found = measured(
            {"before": splats},
            [PLAIN],
            dataset,
            {0: view},
            {0: own},
            {"a": exposure},
            background=white,
            on_picture=lambda: None,
        )
        numbers = found["plain"]["before"]
        assert numbers["psnr"] is not None and numbers["psnr"] > 50
        assert numbers["difference"] is not None
        neutral = exposure.undo(own)
        unclipped = np.clip(neutral, 0, 1) - neutral
        assert abs(numbers["difference"] - 255 * np.abs(unclipped).mean()) < 0.01
