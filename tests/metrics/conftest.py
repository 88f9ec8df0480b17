"""Pictures and datasets the metric tests share."""

from types import SimpleNamespace

import numpy as np
import pytest


@pytest.fixture
def wave_pair():
    """Two [H, W, 3] float64 pictures from a formula, so that other programs can score them too."""

    def make(height, width):
        y, x = np.mgrid[0:height, 0:width].astype(np.float64)
        target = np.stack(
            [
                0.5 + 0.4 * np.sin(x / 7) * np.cos(y / 11),
                0.5 + 0.3 * np.sin((x + y) / 5),
                ((x * 37 + y * 17) % 64) / 63,
            ],
            axis=-1,
        )
        image = np.clip(0.9 * target + 0.04 + 0.08 * np.sin(x * y / 97)[..., None], 0, 1)
        return image, target

    return make


@pytest.fixture
def fake_dataset():
    """A dataset of given photos and masks with the attributes that `evaluate` needs."""

    def make(photos, masks=None, mask_mode="none"):
        masks = masks or [None] * len(photos)
        names = tuple(f"view_{i}.png" for i in range(len(photos)))
        return SimpleNamespace(
            scene=SimpleNamespace(cameras=SimpleNamespace(names=names)),
            image=lambda i: photos[i],
            mask=lambda i: masks[i],
            mask_mode=mask_mode,
        )

    return make


@pytest.fixture
def metrics_dict(fake_dataset, wave_pair):
    """A complete metrics.json of one small view and the pictures of its report."""
    from dataclasses import fields

    from gscore.metrics import Course, Metrics, evaluate
    from gscore.report import PictureCollector

    def make(views=1, size=(48, 64), **changes):
        image, target = wave_pair(*size)
        photos = [np.round(target * 255).astype(np.uint8)] * views
        collector = PictureCollector(count=views)
        dataset = fake_dataset(photos)
        evaluation = evaluate(lambda i: image, dataset, range(views), on_view=collector)
        values = {
            "split": "test",
            "train_views": ["a.png", "b.png"],
            "test_views": list(dataset.scene.cameras.names),
            "mask_mode": "none",
            "background": (0, 0, 0),
            "splats": 1234,
            "sh_degree": 2,
            "storage_bytes": 306_032,
            "steps": 500,
            "train_seconds": 75.0,
            "isa": "scalar",
            "threads": 2,
        }
        values |= changes
        course = {each.name for each in fields(Course)} & set(values)
        metrics = Metrics(
            evaluation=evaluation,
            course=Course(**{name: values.pop(name) for name in course}),
            **values,
        )
        return metrics.content(), collector.views

    return make
