"""Trainings that start from given splats instead of points."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gscore.commands import main
from gscore.config import DataConfig, TrainConfig
from gscore.config_file import load_config
from gscore.errors import ConfigError, DatasetError
from gscore.events import Event, Started, Warn
from gscore.io.ply.splats import read_ply, write_splats
from gscore.raster.api import render
from gscore.splats import Splats
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.run import train
from gscore.trainer.schedule.plan import Plan
from gscore.trainer.trainer import Trainer

CONFIG = TrainConfig(iterations=6, max_splats=400, sh_degree=2, coarse_factor=1)


def with_harmonics(splats: Splats, degree: int) -> Splats:
    """The splats with view-dependent colours."""
    rng = np.random.default_rng(8)
    shape = (len(splats), (degree + 1) ** 2 - 1, 3)
    return replace(splats, shN=rng.normal(size=shape).astype(np.float32) * 0.1)


def first_splats(photos: Any) -> Splats:
    """Some splats in COLMAP world."""
    return Trainer(CONFIG, Analysis(photos=photos)).splats()


def test_the_first_picture_is_that_of_the_given_splats(make_photos: Callable[..., Any]) -> None:
    """Oracle: `gscore.render` of the same splats with the capture's own cameras."""
    photos = make_photos()
    start = with_harmonics(first_splats(photos).subset(np.arange(0, 150, 2)), 2)
    trainer = Trainer(CONFIG, Analysis(photos=photos, start=start))
    cameras = photos.scene.cameras
    for i in (0, 5):
        K, viewmat = cameras.Ks[i], cameras.viewmats[i]
        wanted = render(start, K, viewmat, int(cameras.widths[i]), int(cameras.heights[i])).rgb
        assert wanted.mean() > 0.05
        got = trainer.renderer.picture(i, background=(0, 0, 0))
        np.testing.assert_allclose(got, wanted, atol=2e-4)


def test_opacities_may_be_carried_in_part(make_photos: Callable[..., Any]) -> None:
    """Oracle: the activated opacities times the share, of opaque splats too."""
    photos = make_photos()
    start = first_splats(photos)
    start.opacities[:3] = [-4, 0, 20]
    faded = Trainer(
        replace(CONFIG, start_opacity=0.6), Analysis(photos=photos, start=start)
    ).splats()
    before, after = (1 / (1 + np.exp(-s.opacities.astype(np.float64))) for s in (start, faded))
    np.testing.assert_allclose(after, 0.6 * before, rtol=1e-5)
    with pytest.raises(ConfigError, match="start_opacity must be more than 0, at most 1"):
        replace(CONFIG, start_opacity=0.0)


def test_the_config_bounds_degree_and_number(make_photos: Callable[..., Any]) -> None:
    """Oracle: the shapes that TrainConfig allows."""
    photos = make_photos()
    start = with_harmonics(first_splats(photos), 2)
    trainer = Trainer(replace(CONFIG, sh_degree=1), Analysis(photos=photos, start=start))
    np.testing.assert_array_equal(trainer.splats().shN, start.shN[:, :3])
    with pytest.raises(ConfigError, match="raise `--max-splats`"):
        Trainer(replace(CONFIG, max_splats=149), Analysis(photos=photos, start=start))
    with pytest.raises(ConfigError, match="are 0"):
        Trainer(CONFIG, Analysis(photos=photos, start=start.subset(np.zeros(0, np.int64))))


def test_a_run_starts_from_a_ply_and_goes_on_from_its_checkpoint(
    capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: the number of splats in the PLY; the bits of the unbroken run."""
    base = ["train", str(capture), "--max-splats", "400", "--sh-degree", "1", "--quiet"]
    assert main([*base, "-o", str(tmp_path / "first"), "--iterations", "5"]) == 0
    ply = tmp_path / "some.ply"
    grown = read_ply(tmp_path / "first" / "point_cloud.ply")
    write_splats(ply, grown.subset(np.arange(0, len(grown), 2)))
    warm = [*base, "--iterations", "12", "--start-splats", str(ply)]
    whole = tmp_path / "whole"
    assert main([*warm, "-o", str(whole), "--checkpoint-iterations", "6"]) == 0
    data, config = load_config(whole / "config.json")
    assert config.start_splats == ply
    begun: list[Event] = []
    train(replace(config, iterations=1), data, tmp_path / "one", begun.append)
    counts = [event.splats for event in begun if isinstance(event, Started)]
    assert counts == [len(read_ply(ply))]
    half = whole / "checkpoints" / "step_00000006.safetensors"
    rest = tmp_path / "rest"
    assert main([*warm, "-o", str(rest), "--start-checkpoint", str(half)]) == 0
    both = [(folder / "point_cloud.ply").read_bytes() for folder in (whole, rest)]
    assert both[0] == both[1]


def test_given_splats_see_full_photos_from_the_first_step() -> None:
    """Oracle: the factor of the first step, with and without splats, and with the option set."""
    blank = TrainConfig(iterations=500)
    warm = replace(blank, start_splats=Path("some.ply"))
    asked = replace(warm, coarse_factor=2.0)
    plans = [
        Plan.of(c, extent=1.0, points=10, side=300, pixels=90_000) for c in (blank, warm, asked)
    ]
    assert [plan.factor_at(1) for plan in plans] == [4.0, 1.0, 2.0]


def test_bad_starts_are_named(capture: Path, tmp_path: Path) -> None:
    """Oracle: the file in the message; a warning for another antialias setting."""
    data = DataConfig(source=capture)
    missing = replace(CONFIG, start_splats=tmp_path / "none.ply")
    with pytest.raises(DatasetError, match=r"none\.ply"):
        train(missing, data, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    train(replace(CONFIG, antialias=True), data, tmp_path / "mip")
    reported: list[str] = []
    train(
        replace(CONFIG, start_splats=tmp_path / "mip" / "point_cloud.ply"),
        data,
        tmp_path / "out",
        lambda event: reported.append(event.message) if isinstance(event, Warn) else None,
    )
    assert any("was trained with antialiasing" in message for message in reported)
    write_splats(tmp_path / "many.ply", first := read_ply(tmp_path / "mip" / "point_cloud.ply"))
    few = replace(CONFIG, start_splats=tmp_path / "many.ply", max_splats=len(first) - 1)
    with pytest.raises(ConfigError, match="max_splats"):
        train(few, data, tmp_path / "other")
