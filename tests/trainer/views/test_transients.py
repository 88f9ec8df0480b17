"""Transients; oracles: scenes by design, runs without, uninterrupted runs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gscore.config import TrainConfig
from gscore.engine.base import DrawnPicture
from gscore.io.images.pixels import as_uint8
from gscore.raster.api import render
from gscore.raster.request import Frustum
from gscore.scene import Cameras, PointCloud, Scene
from gscore.sh import rgb_to_sh0
from gscore.splats import Splats
from gscore.stress.capture import ToyPhotos
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.files.run_folder import RunFolder
from gscore.trainer.files.run_outputs import RunOutputs
from gscore.trainer.trainer import Trainer
from gscore.trainer.views import transient_search
from gscore.trainer.views.transient_search import (
    Residual,
    cells_of,
    find_transients,
    residual_of,
)
from gscore.trainer.views.transients import Transients
from tests.trainer.trainer_bits import compare_resumed
from tests.trainer.views.test_photo_blurs import studio

SIZE = 60, 40
"""Columns and rows of a map."""


def view(x: float, *, turned: float = 0.0) -> Frustum:
    """A camera at (x, 0, 0) that looks along z, or turned about the y axis, degrees."""
    c, s = np.cos(np.radians(turned)), np.sin(np.radians(turned))
    viewmat = np.eye(4)
    viewmat[:3, :3] = [[c, 0, -s], [0, 1, 0], [s, 0, c]]
    viewmat[:3, 3] = -viewmat[:3, :3] @ [x, 0, 0]
    width, height = SIZE
    K = np.array([[60.0, 0, width / 2], [0, 60, height / 2], [0, 0, 1]])
    return Frustum(viewmat, K, width, height)


def wall(*, count: int = 10) -> dict[int, Residual]:
    """Views of a wall at z = 4, 0.2 apart, that differ from their photos by 0.02."""
    return {
        2 * i: Residual(
            view(0.2 * i),
            np.full(SIZE[::-1], 0.02, np.float32),
            np.full(SIZE[::-1], 0.25, np.float32),
            np.ones(SIZE[::-1], bool),
            np.zeros(SIZE[::-1], bool),
        )
        for i in range(count)
    }


def test_what_one_photo_shows_is_found() -> None:
    """Oracle: a block in one photo, and cells around it that differ less."""
    views = wall()
    views[6].difference[10:20, 20:30] = 0.3
    views[6].difference[20:22, 20:30] = 0.07
    found = find_transients(views)
    assert list(found) == [6]
    assert found[6][10:22, 20:30].all() and not found[6][:7].any()
    assert not found[6][25:].any() and found[6].sum() < 1.9 * 12 * 10


def test_what_several_photos_miss_is_not_found() -> None:
    """Oracle: a mark on the wall that no render shows: each camera, 0.2 further, has it 3 px
    further left."""
    views = wall()
    for i, one in enumerate(views.values()):
        left = 30 - 3 * i
        one.difference[10:20, left : left + 10] = 0.3
    assert find_transients(views) == {}


def test_what_no_other_photo_shows_is_not_found() -> None:
    """Oracle: another depth there, a view turned away, too few views, transparent places, a small
    spot and a whole photo."""
    block = np.s_[10:20, 20:30]
    views = wall()
    views[6].difference[block] = 0.3
    views[6].inverse_depth[block] = 0.5
    assert find_transients(views) == {}
    views[6].inverse_depth[block] = 0
    assert find_transients(views) == {}
    views = wall()
    views[6].difference[block] = 0.3
    turned = {i: one._replace(view=view(0, turned=90)) for i, one in views.items() if i != 6}
    assert find_transients(views | turned) == {}
    assert find_transients({i: views[i] for i in (4, 6, 8)}) == {}
    assert list(find_transients({i: views[i] for i in (2, 4, 6, 8)})) == [6]
    views = wall()
    views[6].difference[10, 20:22] = 0.3
    assert find_transients(views) == {}
    views[6].difference[:] = 0.3
    assert find_transients(views) == {}


def test_outlines_are_not_found() -> None:
    """Oracle: a block beside an edge of depth; one that reaches from there into a surface is found
    whole."""
    views = wall()
    for one in views.values():
        one.inverse_depth[:, :10] = 0.5
    views[6].difference[10:20, 10:14] = 0.3
    assert find_transients(views) == {}
    views[6].difference[10:20, 10:30] = 0.3
    assert find_transients(views)[6][10:20, 10:30].all()


def test_differences_must_exceed_those_of_others() -> None:
    """Oracle: the limits of docs/photos.md: thrice the median of the others, 2.5 times the 90 %
    quantile of all, half of both for what is connected, and 0.7 of a photo."""
    block, joined = np.s_[10:20, 20:30], np.s_[10:20, 36:44]
    for usual, is_found in ((0.09, False), (0.07, True)):
        views = wall()
        for one in views.values():
            one.difference[8:12] = usual  # a tenth of all cells
        views[6].difference[8:12, 20:30] = 0.25
        assert (6 in find_transients(views)) == is_found, usual
    for rough, is_found in ((0.09, False), (0.07, True)):
        views = wall()
        for one in views.values():
            one.difference[25:] = rough
        views[6].difference[block] = 0.2
        assert (6 in find_transients(views)) == is_found, rough
    views = wall()
    views[6].difference[block] = 0.13
    views[6].difference[10:20, 30:44] = 0.07
    assert find_transients(views)[6][joined].all()
    for rows, is_found in ((24, True), (30, False)):
        views = wall()
        views[6].difference[:rows] = 0.3
        assert (6 in find_transients(views)) == is_found, rows


def test_highlights_are_not_found() -> None:
    """Oracle: a bright spot that is brighter than its render, and one that is darker; small spots
    that wander over the wall with the camera, and larger ones."""
    block = np.s_[10:20, 20:30]
    views = wall()
    views[6].difference[block], views[6].highlight[block] = 0.3, True
    assert find_transients(views) == {}
    views[6].highlight[15, 25] = False
    assert find_transients(views)[6][block].all()
    for size, count in ((3, 0), (14, 10)):
        views = wall()
        for one in views.values():
            one.difference[10 : 10 + size, 20 : 20 + size] = 0.3
        assert len(find_transients(views)) == count


def test_masks_of_the_capture_do_not_count() -> None:
    """Oracle: what they hide is in no quantile and no share, and is not masked again."""
    views = wall()
    for one in views.values():
        one.known[:, 12:] = False
        one.difference[:] = np.where(one.known, 0.06, 0)
    views[6].difference[10:20, :8] = 0.14
    assert find_transients(views) == {}
    views = wall()
    for one in views.values():
        one.known[:, 30:] = False
    views[6].difference[10:20, 20:30] = 0.3
    assert not find_transients(views)[6][:, 30:].any()
    views[6].difference[:, :30] = 0.3
    assert find_transients(views) == {}


def test_a_residual_is_smooth_and_respects_masks() -> None:
    """Oracle: fine stripes cancel out, a constant stays, masked pixels are 0; the depth of an
    opaque cell, none of another."""
    frustum = replace(view(0), width=480, height=320)
    photo = np.full((320, 480, 3), 102, np.uint8)
    grey = np.full((320, 480, 3), 0.4, np.float32)
    stripes = grey + 0.4 * (np.arange(480, dtype=np.float32)[:, None] // 2 % 2 - 0.5)
    alpha = np.full((320, 480), 0.8, np.float32)
    alpha[:, :240] = 0.2
    given = {"inverse_depth": 0.25 * alpha, "alpha": alpha}
    found = residual_of(frustum, stripes, photo, None, **given)
    assert found.difference.shape == cells_of(480, 320)[::-1] == (107, 160)
    assert found.difference[10:-10, 10:-10].max() < 0.02
    assert (
        found.inverse_depth[:, 80:] == pytest.approx(0.25) and not found.inverse_depth[:, :80].any()
    )
    assert (found.view.width, found.view.height) == (160, 107)
    np.testing.assert_allclose(found.view.K[0], [20, 0, 10])
    mask = np.full((320, 480), 255, np.uint8)
    mask[:, :240] = 0
    found = residual_of(frustum, grey + 0.2, photo, mask, **given).difference
    assert found[30:-30, 100:-20] == pytest.approx(0.2, abs=1e-4) and found[:, :60].max() < 1e-3
    for own, is_highlight in ((230, True), (127, False), (51, False)):
        bright = np.full((320, 480, 3), own, np.uint8)
        found = residual_of(frustum, grey, bright, None, **given)
        assert (found.highlight[30:-30, 30:-30] == is_highlight).all(), own
    broken = grey.copy()
    broken[100, 200], broken[200, 300, 1] = np.nan, np.inf
    for own in (None, mask):
        found = residual_of(frustum, broken, photo, own, **given).difference
        assert np.isfinite(found).all() and found.max() < 1e-3


@pytest.mark.parametrize("width", [161, 162, 319, 480, 667])
def test_equal_pictures_have_no_residual(width: int) -> None:
    """Oracle: the photo itself, in stripes of any width; highlights beside a mask stay such."""
    height = 2 * width // 3
    frustum = replace(view(0), width=width, height=height)
    photo = np.zeros((height, width, 3), np.uint8)
    photo[:, ::2] = 255
    ones = np.ones((height, width), np.float32)
    given = {"inverse_depth": 0.25 * ones, "alpha": ones}
    same = photo * np.float32(1 / 255)
    assert residual_of(frustum, same, photo, None, **given).difference.max() < 1e-5
    mask = np.full((height, width), 255, np.uint8)
    mask[:, : width // 2] = 0
    photo[:], dark = 171, np.full_like(same, 0.3)
    shown = residual_of(frustum, dark, photo, mask, **given).highlight
    assert shown[:, shown.shape[1] // 2 + 1 :].all()


def test_photos_end_at_white(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: where a photo is white a brighter render agrees with it, and is as sharp."""
    photos = textured_wall()
    height, width = photos.images[0].shape[:2]
    y, x = np.mgrid[:height, :width]
    spot = 0.2 + 3.5 * np.exp(-((x - width / 2) ** 2 + (y - height / 2) ** 2) / 200)
    picture = spot[..., None].repeat(3, axis=2).astype(np.float32)
    photo = as_uint8(np.minimum(picture, 1))
    photos = replace(photos, images=[photo for _ in photos.images])
    renderer = Trainer(
        TrainConfig(iterations=10, max_splats=3000), Analysis(photos=photos)
    ).renderer
    alpha = np.ones((height, width), np.float32)
    drawn = DrawnPicture(picture, alpha, 0.25 * alpha)
    monkeypatch.setattr(renderer, "_draw", lambda *_, **__: drawn)
    assert renderer.residual(0, 1.0).difference.max() < 0.01
    assert np.abs(renderer.photo_blur(0, 1.0).covariance).max() < 1e-6


def test_masks_fit_any_size() -> None:
    """Oracle: a half of the cells is a half of the pixels."""
    views, masks = wall(), Transients(range(0, 20, 2))
    views[6].difference[:, :25] = 0.3
    assert masks.of(6, 60, 40) is None and masks.arrays() == {}
    masks.note(views, 12)
    share = masks.shares[6]
    assert 25 / 60 < share < 30 / 60 and masks.step == 12
    for width, height in ((60, 40), (601, 400), (30, 20)):
        mask = masks.of(6, width, height)
        assert mask is not None and mask.shape == (height, width)
        assert set(np.unique(mask)) == {0, 255}
        assert 1 - mask.mean() / 255 == pytest.approx(share, abs=0.02)
    assert masks.of(4, 60, 40) is None
    names = [f"{i}.jpg" for i in range(20)]
    decision = masks.decision(names)
    assert decision is not None
    assert decision.text.startswith("1 training photo has parts that other photos contradict")
    assert f"up to {100 * share:.0f} % of a photo: 6.jpg." in decision.text


def test_transients_are_measured_as_planned() -> None:
    """Oracle: the planned steps; the third only if the second found any; none with few photos."""
    masks, planned = Transients(range(0, 20, 2)), [10, 20, 30]
    assert not masks.due(planned, 9) and masks.due(planned, 10)
    masks.note(wall(), 10)
    assert masks.decision(["a"] * 20) is None
    assert not masks.due(planned, 19) and masks.due(planned, 21)
    masks.note(wall(), 21)
    assert not masks.due(planned, 30)
    views = wall()
    views[6].difference[10:20, 20:30] = 0.3
    masks.note(views, 21)
    assert masks.due(planned, 30)
    assert not Transients(range(7)).due(planned, 10)


def test_the_state_is_restored_and_checked() -> None:
    """Oracle: a round trip; damaged arrays."""
    views, masks = wall(), Transients(range(0, 20, 2))
    views[6].difference[10:20, 20:30] = 0.3
    views[8].difference[10:20, 20:33] = 0.3
    masks.note(views, 10)
    other = Transients(range(0, 20, 2))
    other.restore(masks.arrays())
    assert other.step == 10 and other.shares == masks.shares
    for index in (6, 8):
        np.testing.assert_array_equal(other.of(index, 60, 40), masks.of(index, 60, 40))
    good = masks.arrays()
    for name, damaged in (
        ("masks", good["transient/masks"][:-1]),
        ("masks", np.append(good["transient/masks"], np.uint8(1))),
        ("photos", np.array([[5, 40, 60], [8, 40, 60]])),
        ("photos", np.array([[6, -1, 60], [8, 40, 60]])),
        ("photos", np.array([[6, 40, 60], [6, 40, 60]])),
        ("photos", np.array([[6, 0, 0], [8, 40, 60]])),
        ("photos", np.array([[6, 40, 161], [8, 40, 60]])),
        ("photos", np.zeros((1, 2), np.int64)),
        ("photos", np.zeros((2, 3))),
        ("masks", good["transient/masks"].astype(float)),
        ("masks", np.array(1, np.uint8)),
        ("step", np.array(10)),
        ("step", np.array([0])),
    ):
        with pytest.raises(ValueError, match="transient/"):
            other.restore(good | {f"transient/{name}": damaged})
    other.restore({})
    assert other.shares == {} and other.arrays() == {}


def textured_wall() -> ToyPhotos:
    """Photos of a wall of coloured splats at z = 4, 96 x 64 px, from 16 places in a row."""
    rng = np.random.default_rng(4)
    columns, rows = 56, 36
    x, y = np.meshgrid(np.linspace(-4.2, 4.2, columns), np.linspace(-2.7, 2.7, rows))
    count = columns * rows
    means = np.stack([x.ravel(), y.ravel(), np.full(count, 4.0)], axis=-1)
    colors = rng.random((rows // 4, columns // 4, 3)).repeat(4, 0).repeat(4, 1).reshape(-1, 3)
    splats = Splats(
        means=means.astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        scales=np.full((count, 3), np.log(0.08), np.float32),
        opacities=np.full(count, 4.0, np.float32),
        sh0=rgb_to_sh0(0.2 + 0.6 * colors[:, None]).astype(np.float32),
        shN=np.zeros((count, 0, 3), np.float32),
    )
    views, size = 16, (96, 64)
    viewmats = np.tile(np.eye(4), (views, 1, 1))
    viewmats[:, 0, 3] = np.linspace(1.2, -1.2, views)
    viewmats[:, 1, 3] = 0.2 * np.cos(np.arange(views))
    K = np.array([[90.0, 0, size[0] / 2], [0, 90, size[1] / 2], [0, 0, 1]])
    images = [as_uint8(render(splats, K, one, *size, device="cpu").rgb) for one in viewmats]
    cameras = Cameras(
        viewmats=viewmats,
        Ks=np.repeat(K[None], views, axis=0),
        widths=np.full(views, size[0]),
        heights=np.full(views, size[1]),
        names=tuple(f"{i:02}.png" for i in range(views)),
    )
    near = means + rng.normal(size=means.shape) * 0.02
    points = PointCloud(points=near, colors=np.full((count, 3), 128, np.uint8))
    return ToyPhotos(
        scene=Scene(cameras=cameras, points=points),
        train=list(range(views)),
        test=[],
        images=images,
        masks=[None] * views,
    )


def pasted(photos: ToyPhotos, views: tuple[int, ...]) -> ToyPhotos:
    """Photos with a yellow block in some views, each time elsewhere."""
    images = [image.copy() for image in photos.images]
    for k, i in enumerate(views):
        images[i][15 + 6 * k : 40 + 6 * k, 20 + 12 * k : 45 + 12 * k] = (250, 220, 30)
    return replace(photos, images=images)


def trained(photos: ToyPhotos, *, transient_masks: bool) -> Trainer:
    """A trainer after its last step."""
    config = TrainConfig(
        iterations=500, max_splats=3000, sh_degree=1, transient_masks=transient_masks
    )
    trainer = Trainer(config, Analysis(photos=photos))
    for _ in range(config.iterations):
        trainer.step()
    return trainer


def test_pasted_blocks_are_masked(tmp_path: Path) -> None:
    """Oracle: where they were pasted, and what the photos showed before, which is closer."""
    clean, where = textured_wall(), (3, 6, 11)
    photos, errors = pasted(clean, where), []
    for transient_masks in (True, False):
        trainer = trained(photos, transient_masks=transient_masks)
        found = trainer.photo_parameters.transients
        assert (found is not None) == transient_masks
        if found is not None:
            assert set(where) <= set(found.shares)
            for i in where:
                height, width = photos.images[i].shape[:2]
                mask = found.of(i, width, height)
                block = (photos.images[i] != clean.images[i]).any(axis=2)
                assert mask is not None and (mask[block] == 0).mean() > 0.9
                assert (mask[~block] == 0).mean() < 0.2
            names = photos.scene.cameras.names
            entries = RunOutputs(trainer, RunFolder(tmp_path)).write_photo_parameters(None, "")
            assert {names[i] for i in where} <= entries["transients"].keys()
        renders = [trainer.renderer.picture(i, background=(0, 0, 0)) for i in where]
        truth = [clean.images[i] / 255 for i in where]
        errors.append(np.mean([(a - b) ** 2 for a, b in zip(renders, truth, strict=True)]))
    assert errors[0] < errors[1] < 2e-4


def test_photos_without_transients_change_no_bit() -> None:
    """Oracle: a training without masks."""
    photos = textured_wall()
    first, second = (trained(photos, transient_masks=one) for one in (True, False))
    found = first.photo_parameters.transients
    assert found is not None and found.step and not found.shares
    for a, b in zip(vars(first.splats()).values(), vars(second.splats()).values(), strict=True):
        np.testing.assert_array_equal(a, b)


def test_resume_is_bit_equal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: an uninterrupted run, from checkpoints before, at and after measures (12, 24, 36);
    here any difference is a transient."""
    changed = {"_DIFFERENT": 0.05, "_OFTEN": 0.0, "_TIMES": 1e-9, "_NEAR_EDGE": 0, "_LARGEST": 1.0}
    changed |= {"_SAME_DEPTH": 1e9, "_LOWER_TIMES": 1e-9}
    for name, value in changed.items():
        monkeypatch.setattr(transient_search, name, value)
    photos = pasted(textured_wall(), (4, 9))
    config = TrainConfig(iterations=60, max_splats=2000, coarse_factor=1.0)
    whole = compare_resumed(config, photos, tmp_path, (11, 12, 13, 24, 30))
    assert whole.photo_parameters.transients is not None
    assert whole.photo_parameters.transients.shares


def test_masks_of_the_capture_stay() -> None:
    """Oracle: a masked view has both masks; opacity, a region and start splats have no
    transients."""
    photos = studio(blurred_views=())
    given = np.full(photos.images[0].shape[:2], 255, np.uint8)
    given[:20] = 0
    photos = replace(photos, masks=[given] * len(photos.images), mask_mode="ignore")
    trainer = Trainer(TrainConfig(iterations=40, coarse_factor=1.0), Analysis(photos=photos))
    found = trainer.photo_parameters.transients
    assert found is not None
    views = dict(enumerate(wall(count=20).values()))
    views[3].difference[:, :25] = 0.3
    found.note(views, 8)
    sized = trainer.renderer.sized(3, 1.0)
    mask, height = sized.mask, sized.view.height
    assert mask is not None and not mask[:20].any() and not mask[:, :20].any()
    assert mask[height // 2, -1] == 255 and sized.photo("ignore").version > 0
    assert sized.counted == pytest.approx(mask.mean() / 255)
    assert trainer.renderer.sized(2, 1.0).photo("ignore").version == 0
    opacity = replace(photos, mask_mode="composite")
    other = Trainer(TrainConfig(iterations=40), Analysis(photos=opacity))
    assert other.photo_parameters.transients is None
