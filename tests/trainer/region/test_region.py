"""A part of a result trained again; oracles: bytes, a separate drawing of the box, real photos."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gscore.config import Background, DataConfig, Strategy
from gscore.datasets import load_dataset
from gscore.errors import ConfigError, DatasetError, FormatError
from gscore.formats import read_splats, write_splat_file
from gscore.io.region_file import read_region, write_region
from gscore.raster.request import Settings
from gscore.raster.training_rasterizer import TrainingRasterizer
from gscore.splats import PARAMETERS, Splats
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.files import checkpoint
from gscore.trainer.region.region_photos import RegionBox, RegionPhotos
from gscore.trainer.run import train
from gscore.trainer.trainer import Trainer
from gscore.trainer.views.model_renderer import tiles_of_splats
from tests.trainer.short_run import CONFIG

TURNED = np.array(
    [[0.4, -0.2, 0.0, 0.05], [0.2, 0.4, 0.0, -0.1], [0.0, 0.0, 0.6, 0.1], [0, 0, 0, 1]]
)
"""A box about the middle of the toy capture, turned about its z axis."""


@pytest.fixture
def start(known_splats: Splats, tmp_path: Path) -> Path:
    """The splats of the pictures, with wrong colours in the box."""
    rng = np.random.default_rng(4)
    wrong = known_splats.sh0 + 0.3 * rng.normal(size=known_splats.sh0.shape)
    inside = RegionBox(TURNED).contains(known_splats.means)[:, None, None]
    wrong = np.where(inside, wrong, known_splats.sh0).astype(np.float32)
    path = tmp_path / "start.ply"
    write_splat_file(path, replace(known_splats, sh0=wrong))
    return path


@pytest.fixture
def region(tmp_path: Path) -> Path:
    path = tmp_path / "region.json"
    write_region(path, TURNED)
    return path


def bits(splats: Splats, rows: Any = slice(None)) -> dict[str, bytes]:
    return {
        name: np.ascontiguousarray(getattr(splats, name)[rows]).tobytes()
        for name in PARAMETERS
        if name != "shN"
    }


@pytest.mark.parametrize("strategy", list(Strategy))
def test_frozen_splats_keep_their_bits(
    capture: Path, start: Path, region: Path, tmp_path: Path, strategy: Strategy
) -> None:
    """Oracle: the bytes of the rows of the given PLY with centres outside the box, in order,
    against the first rows of the result; the place of the others in the box."""
    config = replace(CONFIG, strategy=strategy, start_splats=start, region=region)
    result = train(config, DataConfig(source=capture), tmp_path / "out")
    before = read_splats(start)
    local = (before.means - TURNED[:3, 3]) @ np.linalg.inv(TURNED[:3, :3]).T
    outside = np.abs(local).max(axis=1) > 1
    count = int(outside.sum())
    assert 20 < count < len(before) - 20
    after = read_splats(tmp_path / "out" / "point_cloud.ply")
    assert bits(after, slice(count)) == bits(before, outside)
    rest = before.shN.shape[1]
    assert after.shN[:count, :rest].tobytes() == before.shN[outside].tobytes()
    assert not after.shN[:count, rest:].any()
    inside = after.means[count:]
    assert np.abs(
        RegionBox(TURNED).to_unit[:3, :3] @ inside.T + RegionBox(TURNED).to_unit[:3, 3:]
    ).max() < (1 + 1e-5)
    assert len(after) > len(before)  # it grew
    assert bits(result.splats) == bits(after)
    assert json.loads((tmp_path / "out/metrics.json").read_text())["splats"] == len(after)


@pytest.mark.parametrize("strategy", list(Strategy))
def test_a_region_goes_on_bit_by_bit(
    make_photos: Callable[..., Any], known_splats: Splats, tmp_path: Path, strategy: Strategy
) -> None:
    """Oracle: the tensors of an uninterrupted training."""
    config = replace(
        CONFIG, strategy=strategy, start_splats=tmp_path / "a.ply", region=tmp_path / "r"
    )
    photos = make_photos()
    photos.mask_mode = "ignore"

    def made() -> Trainer:
        return Trainer(
            config, Analysis(photos=photos, start=known_splats, region=RegionBox(TURNED))
        )

    def state(trainer: Trainer) -> tuple[Any, Any]:
        return {k: t.numpy().tobytes() for k, t in trainer.tensors().items()}, trainer.state()

    whole = made()
    for step in range(1, 61):
        whole.step()
        if step in (11, 34):
            checkpoint.save(tmp_path / f"{step}", whole, {})
    for stop in (11, 34):
        found, resumed = checkpoint.load(tmp_path / f"{stop}"), made()
        checkpoint.check_same_inputs(found, resumed)
        resumed.restore(found.trainer, found.tensors)
        while resumed.steps < 60:
            resumed.step()
        assert state(resumed) == state(whole)
    moved = Trainer(
        config,
        Analysis(
            photos=photos, start=known_splats, region=RegionBox(TURNED @ np.diag([2, 1, 1, 1]))
        ),
    )
    with pytest.raises(ConfigError, match="its region or its frozen"):
        checkpoint.check_same_inputs(found, moved)


def test_a_run_of_a_region_resumes_from_its_folder(
    capture: Path, start: Path, region: Path, tmp_path: Path
) -> None:
    """Oracle: the bytes of the PLY of an uninterrupted run; a refusal of other splats around the
    region."""
    config = replace(CONFIG, start_splats=start, region=region, checkpoint_iterations=(34,))
    data = DataConfig(source=capture)
    train(config, data, tmp_path / "whole")
    shutil.copytree(tmp_path / "whole", tmp_path / "resumed")
    (tmp_path / "resumed" / "point_cloud.ply").unlink()
    for path in (tmp_path / "resumed" / "checkpoints").iterdir():
        if "34" not in path.name:
            path.unlink()
    shutil.copytree(tmp_path / "resumed", tmp_path / "other")
    train(config, data, tmp_path / "resumed", resume=True)
    files = [tmp_path / name / "point_cloud.ply" for name in ("whole", "resumed")]
    assert files[0].read_bytes() == files[1].read_bytes()
    splats = read_splats(start)
    write_splat_file(start, replace(splats, sh0=splats.sh0 + np.float32(0.5)))
    with pytest.raises(ConfigError, match="its region or its frozen splats differ"):
        train(config, data, tmp_path / "other", resume=True)


def test_the_pixels_of_a_step_are_all_that_a_region_can_change(
    photos: Any, known_splats: Splats
) -> None:
    """Oracle: the region's splats rasterized alone: zero opacity outside the tiles."""
    config = replace(CONFIG, start_splats=Path("a.ply"), region=Path("r"))
    small = replace(known_splats, scales=known_splats.scales - np.float32(2))
    trainer = Trainer(
        config,
        Analysis(
            photos=photos, start=small, region=RegionBox(TURNED @ np.diag([0.7, 0.7, 0.7, 1]))
        ),
    )
    params, hidden = trainer.model.params, 0
    for index in photos.train:
        view = trainer.renderer.view(index)
        alpha = TrainingRasterizer().draw(tuple(params.values()), view, Settings()).alpha.numpy()
        tiles = tiles_of_splats(params["means"].numpy(), params["scales"].numpy(), view)
        shown = np.repeat(np.repeat(tiles, 16, axis=0), 16, axis=1)
        shown = shown[: view.height, : view.width]
        assert (alpha[shown == 0] == 0).all()
        assert alpha.max() > 0
        hidden += int((shown == 0).sum())
    assert hidden > 0


def test_tiles_of_splats_anywhere_before_a_camera(photos: Any) -> None:
    """Oracle: as above, for 400 models of one splat: outside, behind, near and long splats."""
    rng = np.random.default_rng(0)
    trainer = Trainer(CONFIG, Analysis(photos=photos))
    for _ in range(400):
        params = {name: p[:1].clone() for name, p in trainer.model.params.items()}
        params["means"][:] = params["means"].new_tensor(rng.normal(size=3))
        params["scales"][:] = params["scales"].new_tensor(rng.normal(-3, 1.5, size=3))
        params["quats"][:] = params["quats"].new_tensor(rng.normal(size=4))
        params["opacities"][:] = 8.0
        view = trainer.renderer.view(int(rng.integers(len(photos.train))))
        alpha = TrainingRasterizer().draw(tuple(params.values()), view, Settings()).alpha.numpy()
        tiles = tiles_of_splats(params["means"].numpy(), params["scales"].numpy(), view)
        shown = np.repeat(np.repeat(tiles, 16, axis=0), 16, axis=1)
        assert (alpha[shown[: view.height, : view.width] == 0] == 0).all()


def test_the_outline_of_a_box_is_where_points_of_it_are_seen(capture: Path) -> None:
    """Oracle: 200,000 points in the box, projected one by one by plain matrices: each is in the
    outline, and each pixel of the outline has a point, but for a rim."""
    dataset = load_dataset(DataConfig(source=capture))
    cameras, box = dataset.scene.cameras, RegionBox(TURNED)
    rng = np.random.default_rng(1)
    points = rng.uniform(-1, 1, size=(200_000, 3)) @ TURNED[:3, :3].T + TURNED[:3, 3]
    for i in range(len(dataset)):
        width, height = int(cameras.widths[i]), int(cameras.heights[i])
        outline = box.outline(cameras.Ks[i], cameras.viewmats[i], width, height)
        seen = points @ cameras.viewmats[i][:3, :3].T + cameras.viewmats[i][:3, 3]
        x, y, z = (seen[seen[:, 2] > 0.01] @ cameras.Ks[i].T).T
        columns, rows = np.floor(x / z).astype(int), np.floor(y / z).astype(int)
        inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        drawn = np.zeros((height, width), bool)
        drawn[rows[inside], columns[inside]] = True
        assert (
            box.may_be_visible(cameras.Ks[i], cameras.viewmats[i], width, height, 0.01)
            or not drawn.any()
        )
        rim = outline ^ drawn
        assert outline.any()
        assert rim.sum() < 0.15 * outline.sum()


def test_photos_that_do_not_see_a_region_are_left_out(capture: Path) -> None:
    """Oracle: a box behind all cameras but one, which is inside it; a box outside all views."""
    dataset = load_dataset(DataConfig(source=capture, eval=True))
    cameras = dataset.scene.cameras
    one = dataset.train[0]
    box = np.diag([0.01, 0.01, 0.01, 1.0])
    ahead = np.linalg.inv(cameras.viewmats[one]) @ [0, 0, 0.05, 1]
    box[:3, 3] = ahead[:3]
    found = RegionPhotos(dataset, RegionBox(box), near=0.01)
    assert one in found.train and len(found.train) < len(dataset.train)
    box[:3, 3] = 1e3 * np.linalg.inv(cameras.viewmats[one])[:3, 1]
    with pytest.raises(DatasetError, match="None of the"):
        RegionPhotos(dataset, RegionBox(box), near=0.01)


def test_views_without_the_region_do_not_evaluate_it(capture: Path) -> None:
    """Oracle: long thin boxes past a corner of a held-out picture: none of its pixels shows them,
    though they are not entirely beyond one side of it."""
    dataset = load_dataset(DataConfig(source=capture, eval=True))
    cameras, rng, past = dataset.scene.cameras, np.random.default_rng(0), 0
    for _ in range(300):
        matrix = np.eye(4)
        matrix[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0] * (4.0, 0.02, 0.02)
        matrix[:3, 3] = rng.uniform(-3, 3, 3)
        box, one = RegionBox(matrix), dataset.test[0]
        size = int(cameras.widths[one]), int(cameras.heights[one])
        camera = cameras.Ks[one], cameras.viewmats[one], *size
        if not box.may_be_visible(*camera, 0.01):
            continue
        seen = box.outline(*camera).any()
        past += not seen
        assert (one in RegionPhotos(dataset, box, near=0.01).test) == seen
    assert past >= 10


def test_a_region_is_evaluated_on_its_own_pixels(
    capture: Path, start: Path, region: Path, tmp_path: Path
) -> None:
    """Oracle: a rise of the PSNR of held-out photos inside the box over the initial splats."""
    from gscore.metrics import evaluate
    from gscore.raster.api import render

    data = DataConfig(source=capture, eval=True)
    dataset = load_dataset(data)
    evaluated = RegionPhotos(dataset, RegionBox(TURNED), near=0.01)
    cameras, before = dataset.scene.cameras, read_splats(start)

    def picture(i: int) -> np.ndarray:
        size = int(cameras.widths[i]), int(cameras.heights[i])
        return render(before, cameras.Ks[i], cameras.viewmats[i], *size).rgb

    was = evaluate(picture, evaluated, evaluated.test).mean["psnr_masked"]
    config = replace(
        CONFIG,
        iterations=200,
        start_splats=start,
        region=region,
        refine_stop=1,
        reset_every=-1,
        background=Background.BLACK,
    )
    result = train(config, data, tmp_path / "out")
    assert result.psnr is not None
    assert result.psnr > was + 1


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("", "not a region"),
        ("[]", "has no box"),
        ('{"low": [0, 0, 0]}', "high"),
        ('{"low": [0, 0, 0], "high": [1, 0, 1]}', "low corner"),
        ('{"box": [[1, 2], [3, 4]]}', "4 x 4"),
        ('{"box": [[1,0,0,0],[0,1,0,0],[0,0,0,0],[0,0,0,1]]}', "no volume"),
        ('{"box": [[1,0,0,0],[0,1,0,0],[1,1,0,0],[0,0,0,1]]}', "no volume"),
        ('{"box": [[1,0,0,0],[0,1,0,0],[0,0,NaN,0],[0,0,0,1]]}', "numbers"),
        ('{"box": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,1,1]]}', "last row"),
        ('{"box": "here"}', "not a region"),
    ],
)
def test_a_file_that_is_no_region_is_refused(tmp_path: Path, text: str, wrong: str) -> None:
    """Oracle: the missing entry of each file."""
    path = tmp_path / "region.json"
    path.write_text(text)
    with pytest.raises(FormatError, match=wrong) as caught:
        read_region(path)
    assert str(path) in str(caught.value) and '"low"' in str(caught.value)


def test_a_region_is_read_as_it_was_written(tmp_path: Path) -> None:
    """Oracle: the matrix itself, and the corners of a box along the axes."""
    write_region(tmp_path / "a", TURNED)
    assert read_region(tmp_path / "a").tolist() == TURNED.tolist()
    (tmp_path / "b").write_text('{"low": [-1, 0, 2], "high": [1, 4, 3]}')
    assert RegionBox(read_region(tmp_path / "b")).contains(np.array([[-1, 0, 2], [1, 4, 3]])).all()
    assert (
        not RegionBox(read_region(tmp_path / "b"))
        .contains(np.array([[0, 2, 1.9], [0, 4.1, 2.5]]))
        .any()
    )


def test_invalid_region_runs_are_refused(
    known_splats: Splats, photos: Any, capture: Path, tmp_path: Path
) -> None:
    """Oracle: the defect of each: no splats in the box, SH degrees to cut."""
    config = replace(CONFIG, start_splats=tmp_path / "a.ply", region=tmp_path / "r")
    away = TURNED.copy()
    away[:3, 3] = 50
    with pytest.raises(ConfigError, match="None of the"):
        Trainer(config, Analysis(photos=photos, start=known_splats, region=RegionBox(away)))
    rest = np.zeros((len(known_splats), 15, 3), np.float32)
    with pytest.raises(ConfigError, match="`--sh-degree 3`"):
        Trainer(
            replace(config, sh_degree=1),
            Analysis(
                photos=photos, start=replace(known_splats, shN=rest), region=RegionBox(TURNED)
            ),
        )
