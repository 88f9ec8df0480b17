"""Blurs of photos; oracles: photos blurred by scipy, runs without blur, uninterrupted runs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import ndimage

from gscore.config import DataConfig, Skip, TrainConfig
from gscore.datasets import load_dataset
from gscore.shared_constants import BLUR_MAX
from gscore.stress.capture import ToyPhotos
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.files.run_folder import RunFolder
from gscore.trainer.files.run_outputs import RunOutputs
from gscore.trainer.schedule.plan import Plan
from gscore.trainer.trainer import Trainer
from gscore.trainer.views import photo_blurs
from gscore.trainer.views.photo_blurs import BlurFit, PhotoBlurs, fit_blur
from tests.trainer.trainer_bits import compare_resumed

EXAMPLE = Path(__file__).parents[3] / "examples" / "studio"


def picture(height: int = 120, width: int = 160) -> np.ndarray:
    """[H, W, 3] float32 with edges and fine detail."""
    rng = np.random.default_rng(3)
    fine = rng.random((height, width, 3))
    coarse = ndimage.gaussian_filter(rng.random((height, width, 3)), (5, 5, 0)) > 0.5
    return (0.3 * fine + 0.6 * coarse).astype(np.float32)


def blurred(image: np.ndarray, y: float, x: float) -> np.ndarray:
    """The picture with these standard deviations, px, as a photo's bytes."""
    return np.round(255 * ndimage.gaussian_filter(image, (y, x, 0), mode="nearest")).astype(
        np.uint8
    )


@pytest.mark.parametrize("sides", [(0.6, 0.6), (1.5, 1.5), (3.0, 3.0), (0.0, 2.0), (2.5, 0.5)])
def test_a_known_blur_is_found(sides: tuple[float, float]) -> None:
    """Oracle: scipy's Gaussian filter; variances to a tenth, and .1 px^2 of interpolation."""
    y, x = sides
    found = fit_blur(picture(), blurred(picture(), y, x) / 255, None)
    assert found.covariance == pytest.approx([x * x, 0, y * y], rel=0.1, abs=0.1)
    assert found.explained > 0.98


def test_a_blur_along_a_diagonal_is_found() -> None:
    """Oracle: the picture moved along the diagonal, with weights of a Gaussian."""
    image = ndimage.gaussian_filter(picture(), (0.7, 0.7, 0)).astype(np.float32)
    steps = np.arange(-8, 9)
    weights = np.exp(-0.5 * (steps / 2.0) ** 2)
    moved = [np.roll(image, (k, k), (0, 1)) * w for k, w in zip(steps, weights, strict=True)]
    photo = np.round(255 * sum(moved) / weights.sum()).astype(np.uint8)
    assert fit_blur(image, photo / 255, None).covariance == pytest.approx([4, 4, 4], rel=0.1)


def test_a_sharper_photo_has_a_negative_blur() -> None:
    """Oracle: the exchanged pictures; its own picture has none, and black ones have no detail."""
    soft = blurred(picture(), 1, 1)
    found = fit_blur((soft / 255).astype(np.float32), picture(), None)
    assert found.covariance[0] < -0.5 and found.covariance[2] < -0.5 and found.explained == 0
    black = np.zeros((20, 20, 3), np.float32)
    for render, photo in [(picture(), picture()), (black, black), (black[:1], black[:1])]:
        assert fit_blur(render, photo, None).covariance == pytest.approx([0, 0, 0], abs=1e-6)
    assert fit_blur(black * np.nan, black, None).covariance.tolist() == [0, 0, 0]


def test_masked_and_wrong_pixels_count_little() -> None:
    """Oracle: the blur of the other pixels."""
    photo, mask = blurred(picture(), 2, 2), np.full((120, 160), 255, np.uint8)
    photo[:40], mask[:40] = 7, 0
    assert fit_blur(picture(), photo / 255, mask).covariance == pytest.approx(
        [4, 0, 4], rel=0.15, abs=0.15
    )
    photo = blurred(picture(), 2, 2)
    photo[50:70, 60:90] = 255
    assert fit_blur(picture(), photo / 255, None).covariance == pytest.approx(
        [4, 0, 4], rel=0.15, abs=0.3
    )


def some(
    values: dict[int, tuple[float, float]], *, width: int = 100, explained: float = 0.5
) -> dict[int, BlurFit]:
    """Standard deviations in px of photos of this width; the others' are 2 px."""
    sides = dict.fromkeys(range(10), (2.0, 2.0)) | values
    return {
        i: BlurFit(np.array([x * x, 0, y * y]) / width**2, explained) for i, (x, y) in sides.items()
    }


def test_blurs_are_relative_to_the_usual_one() -> None:
    """Oracle: the difference of variances; those below a pixel at the size of a step are none."""
    blurs = PhotoBlurs(range(10), np.full(12, 100))
    assert blurs.of(3, 100) is None
    blurs.note(some({3: (2.0, 4.0), 4: (2.1, 2.1), 5: (0.1, 0.1)}), 1)
    assert blurs.of(3, 100) == pytest.approx((0, 0, 12))
    assert blurs.of(3, 50) == pytest.approx((0, 0, 3)) and blurs.of(3, 28) is None
    assert [i for i in range(12) if blurs.of(i, 100) is not None] == [3]
    found = blurs.decision([f"{i}.jpg" for i in range(12)])
    assert found is not None
    start = "1 training photo is more blurred than the others, by up to 3.5 of 100 px"
    assert found.text.startswith(f"{start} (standard deviation): 3.jpg. ")
    blurs.note(some({3: (2.0, 4.0)}, explained=0.01), 2)
    assert blurs.of(3, 100) is None
    assert PhotoBlurs(range(10), np.full(12, 9000)).of(3, 9000) is None


def test_huge_blurs_stay_within_the_limit_of_the_library() -> None:
    """Oracle: the limit."""
    blurs = PhotoBlurs(range(10), np.full(10, 9000))
    blurs.note(some({3: (5.0, 4.0)}), 1)
    xx, xy, yy = blurs.of(3, 9000) or (0, 0, 0)
    assert max(xx, yy) == pytest.approx(BLUR_MAX, rel=1e-6) and xy == 0


def test_a_blur_of_more_than_a_twentieth_of_a_side_is_none() -> None:
    """Oracle: blurs within and beyond the limit, 8 px of 160; of sharper photos, to first order,
    the same limit."""
    assert fit_blur(picture(), blurred(picture(), 6, 6) / 255, None).covariance[0] > 30
    found = fit_blur(picture(), blurred(picture(), 14, 14) / 255, None)
    assert found.covariance.tolist() == [0, 0, 0] and found.explained == 0
    slope = np.broadcast_to(np.linspace(0, 1, 160, dtype=np.float32)[:, None], (120, 160, 3))
    assert fit_blur(slope, picture(), None).covariance == pytest.approx([0, 0, 0], abs=64)


def test_measuring_ends_where_all_photos_are_sharp() -> None:
    """Oracle: the planned steps; few photos have no usual one, an extended run measures again."""
    planned, longer = [20, 40, 60], [40, 80, 120]
    blurs = PhotoBlurs(range(10), np.full(10, 100))
    assert [step for step in range(70) if blurs.due(planned, step)] == list(range(20, 70))
    blurs.note(some({}, explained=0.01), 20)
    assert not any(blurs.due(planned, step) for step in range(20, 100)) and not blurs.decision([])
    assert [step for step in range(20, 50) if blurs.due(longer, step)] == list(range(40, 50))
    blurs.note(some({}, explained=0.03), 20)
    assert [step for step in range(20, 50) if blurs.due(planned, step)] == list(range(40, 50))
    assert not PhotoBlurs(range(7), np.full(10, 100)).due(planned, 20)


@pytest.mark.parametrize("iterations", [1, 2, 9, 100, 3000, 8000, 30_000])
def test_no_measure_follows_a_reset(iterations: int) -> None:
    """Oracle: the resets of the plan; there are three measures after at least one step."""
    config = TrainConfig(iterations=iterations)
    plan = Plan.of(config, extent=1.0, points=100, side=100, pixels=10_000)
    assert len(plan.compare_steps) == 3 and plan.compare_steps[0] >= 1
    resets = [step for step in range(1, iterations + 1) if plan.resets_at(step)]
    assert bool(resets) == (iterations >= 6000)
    for step in plan.compare_steps:
        assert not any(reset <= step < reset + plan.reset_every // 3 for reset in resets)


def test_state_is_restored() -> None:
    """Oracle: the blurs themselves; damaged ones are refused, none are zero."""
    blurs, other = (PhotoBlurs(range(10), np.full(10, 100)) for _ in range(2))
    assert blurs.arrays() == {}
    blurs.note(some({3: (4, 4)}), 2)
    other.restore(blurs.arrays())
    assert other.of(3, 100) == blurs.of(3, 100)
    assert other.arrays()["blur/facts"].tolist() == [2, 1]
    for name, damaged in (
        ("value", np.zeros((3, 3))),
        ("value", np.full((10, 3), [1e-3, 1e-2, 0])),
        ("facts", np.array([0, 1])),
        ("facts", np.array([2.5, 1])),
        ("facts", np.array([2])),
    ):
        with pytest.raises(ValueError, match="blur/"):
            other.restore(blurs.arrays() | {f"blur/{name}": damaged})
    other.restore({})
    assert other.of(3, 100) is None and other.arrays() == {}


def studio(*, blurred_views: tuple[int, ...]) -> ToyPhotos:
    """Every third photo of the bundled capture, 96 px wide, some blurred by 2 px."""
    found = load_dataset(DataConfig(source=EXAMPLE, max_width=96))
    views = list(range(0, len(found.names), 3))
    images = [found.image(i) for i in views]
    for i in blurred_views:
        images[i] = blurred((images[i] / 255).astype(np.float32), 2, 2)
    return ToyPhotos(
        scene=replace(found.scene, cameras=found.scene.cameras.subset(views)),
        train=list(range(len(views))),
        test=[],
        images=images,
        masks=[None] * len(views),
    )


def trained(photos: ToyPhotos, *, photo_blur: bool) -> Trainer:
    """A trainer after its last step."""
    config = TrainConfig(iterations=500, max_splats=3000, sh_degree=0, photo_blur=photo_blur)
    trainer = Trainer(config, Analysis(photos=photos))
    for _ in range(config.iterations):
        trainer.step()
    return trainer


def test_blurred_photos_leave_the_splats_sharp() -> None:
    """Oracle: which photos were blurred, by how much, and what they looked like before."""
    sharp, photos = studio(blurred_views=()), studio(blurred_views=(4, 13))
    errors = []
    for photo_blur in (True, False):
        trainer = trained(photos, photo_blur=photo_blur)
        blurs = trainer.photo_parameters.blurs
        assert (blurs is not None) == photo_blur
        if blurs is not None:
            assert sorted(blurs.blurred) == [4, 13]
            assert all(1.2 < deviation < 2.4 for deviation in blurs.blurred.values())
        renders = [trainer.renderer.picture(i, background=(0, 0, 0)) for i in (4, 13)]
        truth = [sharp.images[i] / 255 for i in (4, 13)]
        errors.append(np.mean([(a - b) ** 2 for a, b in zip(renders, truth, strict=True)]))
    assert errors[0] < 0.8 * errors[1]


def test_blurred_photos_are_in_the_metrics(tmp_path: Path) -> None:
    """Oracle: covariances by design; a standard deviation of 0.03 of the longer side."""
    photos = studio(blurred_views=())
    trainer = Trainer(TrainConfig(iterations=40), Analysis(photos=photos))
    outputs, blurs = RunOutputs(trainer, RunFolder(tmp_path)), trainer.photo_parameters.blurs
    assert blurs is not None and "blurs" not in outputs.write_photo_parameters(None, "")
    blurs.note({i: BlurFit(np.array([9e-4, 0, 4e-4]) * (i == 3), 0.5) for i in range(20)}, 8)
    cameras = photos.scene.cameras
    assert outputs.write_photo_parameters(None, "") == {
        "blurs": {cameras.names[3]: pytest.approx(0.03 * cameras.heights[3])}
    }


def test_sharp_photos_change_no_bit() -> None:
    """Oracle: a training without."""
    photos = studio(blurred_views=())
    first, second = (trained(photos, photo_blur=one) for one in (True, False))
    assert "blur/value" in first.photo_parameters.arrays()
    columns = zip(first.model.params.values(), second.model.params.values(), strict=True)
    assert all(torch.equal(a, b) for a, b in columns)


def test_upright_photos_are_as_sharp_as_others() -> None:
    """Oracle: equal blurs in px of two orientations of one camera."""
    sides = np.full(10, 640)
    blurs = PhotoBlurs(range(10), sides)
    blurs.note({i: BlurFit(np.array([3.0, 0, 3.0]) / 640**2, 0.5) for i in range(10)}, 20)
    photos = studio(blurred_views=())
    cameras = photos.scene.cameras
    assert (cameras.heights > cameras.widths).all()
    fits = trained(photos, photo_blur=True).photo_parameters.blurs
    assert not blurs.blurred and fits is not None
    np.testing.assert_array_equal(fits._sides, cameras.heights)


@pytest.mark.parametrize("mode", ["ignore", "composite"])
def test_masked_tiles_do_not_change_a_blurred_step(mode: str) -> None:
    """Oracle: a training that draws the tiles that the masks hide, too; with a blur that reaches
    out of them."""
    photos = studio(blurred_views=())
    mask = np.zeros(photos.images[0].shape[:2], np.uint8)
    mask[20:70, 20:70] = 255
    photos = replace(photos, masks=[mask] * len(photos.images), mask_mode=mode)
    runs = []
    for without in ((), (Skip.MASKED_TILE,)):
        config = TrainConfig(iterations=40, max_splats=2000, without=without, coarse_factor=1.0)
        trainer = Trainer(config, Analysis(photos=photos))
        blurs = trainer.photo_parameters.blurs
        assert blurs is not None
        blurs.note({i: BlurFit(np.array([9e-4, 0, 9e-4]) * (i < 3), 0.5) for i in range(20)}, 40)
        runs.append([trainer.step().loss for _ in range(40)])
    assert runs[0] == pytest.approx(runs[1], rel=1e-6)


def test_resume_is_bit_equal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: an uninterrupted run, from checkpoints before, at and after measures (12, 24, 36);
    here chance is a blur."""
    for name in ("_SURE", "_LIKELY", "_LEAST"):
        monkeypatch.setattr(photo_blurs, name, -1.0)
    photos, config = studio(blurred_views=(4,)), TrainConfig(iterations=60, max_splats=2000)
    config = replace(config, coarse_factor=1.0)
    whole = compare_resumed(config, photos, tmp_path, (11, 12, 13, 24, 30))
    assert whole.photo_parameters.blurs is not None and whole.photo_parameters.blurs.blurred
