"""A region of real photos; oracle: held-out photos, and the bytes around the region."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.formats import read_splats
from gscore.io.exposure_json import read_exposures
from gscore.io.region_file import read_region
from gscore.metrics import evaluate
from gscore.presets import preview
from gscore.raster.api import render
from gscore.trainer.region.region_photos import RegionBox, RegionPhotos
from gscore.trainer.run import train

pytestmark = [
    pytest.mark.data,
    pytest.mark.skipif("GSCORE_DATA" not in os.environ, reason="GSCORE_DATA is not set"),
]


def test_a_region_of_plush_gets_better_and_the_rest_stays(tmp_path: Path) -> None:
    """Oracle: PSNR of held-out photos against the previous result: 0.2 dB more inside the box, no
    less in whole pictures, both with the exposures of the first run; equal bytes outside."""
    data, config = preview(Path(os.environ["GSCORE_DATA"]) / "data" / "plush")
    data = DataConfig(source=data.source, max_width=250, eval=True)
    config = replace(config, iterations=400, max_splats=30_000)
    train(config, data, tmp_path / "whole")
    before = read_splats(tmp_path / "whole" / "point_cloud.ply")
    low, high = np.quantile(before.means, [0.3, 0.7], axis=0)
    region = tmp_path / "region.json"
    region.write_text(json.dumps({"low": low.tolist(), "high": high.tolist()}))
    again = replace(
        config,
        max_splats=60_000,
        region=region,
        start_splats=tmp_path / "whole" / "point_cloud.ply",
    )
    train(again, data, tmp_path / "again")
    after = read_splats(tmp_path / "again" / "point_cloud.ply")

    outside = ((before.means < low) | (before.means > high)).any(axis=1)
    count = int(outside.sum())
    assert 1000 < count < len(before) - 1000
    for name in ("means", "quats", "scales", "opacities", "sh0", "shN"):
        kept = getattr(after, name)[:count]
        assert kept.tobytes() == getattr(before, name)[outside].tobytes()

    dataset = load_dataset(data)
    cameras = dataset.scene.cameras
    evaluated = RegionPhotos(dataset, RegionBox(read_region(region)), near=config.near)

    exposures, kept = (read_exposures(tmp_path / name) for name in ("whole", "again"))
    for name in cameras.names:
        np.testing.assert_allclose(kept[name], exposures[name], rtol=1e-9)

    def worth(splats: object, photos: object, key: str) -> float:
        def picture(i: int) -> np.ndarray:
            size = int(cameras.widths[i]), int(cameras.heights[i])
            picture = render(splats, cameras.Ks[i], cameras.viewmats[i], *size).rgb
            return np.clip(exposures[cameras.names[i]].apply(picture), 0, 1).astype(np.float32)

        return evaluate(picture, photos, dataset.test).mean[key]

    assert worth(after, evaluated, "psnr_masked") > worth(before, evaluated, "psnr_masked") + 0.2
    assert worth(after, dataset, "psnr") >= worth(before, dataset, "psnr")
