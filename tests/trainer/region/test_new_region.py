"""A region from the first step of a training; oracles: the outline of its box, bytes."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gscore.commands import main
from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.errors import ConfigError, DatasetError
from gscore.events import Started
from gscore.io.region_file import write_region
from gscore.text_format import psnr_name
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.region.region_photos import RegionBox, RegionPhotos
from gscore.trainer.run import train
from gscore.trainer.trainer import Trainer
from tests.trainer.short_run import CONFIG

BOX = np.diag([0.3, 0.3, 0.3, 1.0])
"""About the middle of the toy capture; half of its points lie outside."""
ANEW = replace(CONFIG, region=Path("r"))


@pytest.mark.parametrize("narrow", [False, True])
def test_only_pixels_that_look_at_the_region_count(capture: Path, narrow: bool) -> None:
    """Oracle: the outline of the box, which has its own test; it is in the masks of training views
    where narrowed, of held-out views always."""
    dataset = load_dataset(DataConfig(source=capture, eval=True))
    box, cameras = RegionBox(BOX), dataset.scene.cameras
    found = RegionPhotos(dataset, box, near=0.01, narrow=narrow)
    assert found.mask_mode == "ignore" and found.test
    for index in (*found.train, *found.test):
        size = int(cameras.widths[index]), int(cameras.heights[index])
        outline = box.outline(cameras.Ks[index], cameras.viewmats[index], *size)
        assert 0 < outline.mean() < 1
        mask = found.mask(index)
        if narrow or index in found.test:
            assert mask is not None and np.array_equal(mask > 0, outline)
        else:
            assert mask is None


def test_pixels_outside_the_region_have_no_effect(capture: Path) -> None:
    """Oracle: the bits of the same training with photos that are black around the region."""

    class Blackened(RegionPhotos):
        def image(self, index: int) -> np.ndarray:
            mask = self.mask(index)
            assert mask is not None
            return super().image(index) * (mask > 0)[..., None].astype(np.uint8)

    def trained(kind: type[RegionPhotos]) -> bytes:
        dataset = load_dataset(DataConfig(source=capture))
        photos = kind(dataset, RegionBox(BOX), near=0.01, narrow=True)
        # Other tests cover exposure and stereo on whole photos; here they only enter the loss.
        trainer = Trainer(ANEW, Analysis(photos=photos, region=RegionBox(BOX)))
        for _ in range(30):
            trainer.step()
        return trainer.splats().means.tobytes()

    assert trained(Blackened) == trained(RegionPhotos)


def test_photos_that_masks_cut_out_are_refused(capture: Path) -> None:
    """Oracle: masks that are opacity already, which a region cannot narrow."""
    dataset = load_dataset(DataConfig(source=capture))
    dataset.mask_mode = "composite"
    with pytest.raises(ConfigError, match="mask-mode ignore"):
        RegionPhotos(dataset, RegionBox(BOX), near=0.01, narrow=True)


def test_a_region_without_points_is_refused(capture: Path) -> None:
    """Oracle: a box in the photos, far behind all points."""
    dataset = load_dataset(DataConfig(source=capture))
    direction = dataset.scene.cameras.viewmats[0][2, :3]
    far = np.eye(4)
    far[:3, 3] = 100 * direction
    with pytest.raises(DatasetError, match="points of the capture is in the region"):
        RegionPhotos(dataset, RegionBox(far), near=0.01, narrow=True)
    assert RegionPhotos(dataset, RegionBox(far), near=0.01).train


def test_another_region_does_not_go_on(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: a resumed run in its own box, named from any folder; a refusal of another box."""
    monkeypatch.chdir(tmp_path)
    config = replace(ANEW, iterations=40, region=Path("r.json"))
    write_region(tmp_path / "r.json", BOX)
    source = DataConfig(source=capture)
    train(config, source, tmp_path / "out")
    longer = replace(config, iterations=50, region=tmp_path / "r.json")
    assert train(longer, source, tmp_path / "out", resume=True).steps == 50
    write_region(tmp_path / "r.json", BOX * [[2], [2], [2], [1]])
    with pytest.raises(ConfigError, match="its region or its frozen"):
        train(replace(config, iterations=60), source, tmp_path / "out", resume=True)


def test_a_run_says_what_it_trains(capture: Path, tmp_path: Path) -> None:
    """Oracle: the sentence of the event, and the results of a run."""
    write_region(tmp_path / "r.json", BOX)
    reported = []
    config = replace(CONFIG, region=tmp_path / "r.json")
    result = train(config, DataConfig(source=capture, eval=True), tmp_path / "out",
                   on_event=reported.append)  # fmt: skip
    (sentence,) = [event.decision("region") for event in reported if isinstance(event, Started)]
    assert "show the region are trained" in sentence
    assert result.metrics is not None and result.metrics["psnr_masked"] > 0


def test_measured_again_it_is_the_region_still(
    capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: the figures of the training; a warning without the file of the region."""
    write_region(tmp_path / "r.json", BOX)
    config = replace(CONFIG, region=tmp_path / "r.json")
    result = train(config, DataConfig(source=capture, eval=True), tmp_path / "out")
    words = ["eval", str(tmp_path / "out"), "-o", str(tmp_path / "again"), "--json", "--overwrite"]
    assert main(words) == 0
    again = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert psnr_name(again) == psnr_name(result.metrics) == "PSNR inside the region"
    for key in ("psnr_masked", "psnr", "ssim"):
        assert again[key] == pytest.approx(result.metrics[key], abs=1e-4)
    (tmp_path / "r.json").unlink()
    assert main(words) == 0
    assert "whole pictures are measured" in capsys.readouterr().err
