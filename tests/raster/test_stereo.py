"""The stereo kernels; oracles: the float64 twin, exactly known depth, other numbers of threads."""

from dataclasses import replace

import numpy as np
import pytest

from gscore.errors import Cancelled, ShapeError
from gscore.raster.request import CancelFlag
from gscore.raster.stereo_depth import StereoView, check, sweep
from tests.raster.twins import stereo as twin
from tests.stereo.scene import Scene

RANGE = {"farthest": 0.12, "nearest": 0.32}


def shots(scene: Scene, *angles: float) -> list[tuple[StereoView, np.ndarray]]:
    """Photos and depths from several sides."""
    return [scene.shot(scene.viewmat(angle)) for angle in angles]


@pytest.mark.parametrize("size", [(96, 72), (61, 47), (33, 25), (17, 9)])
@pytest.mark.parametrize(("radius", "best", "sources"), [(3, 2, 3), (1, 1, 1), (2, 2, 2)])
def test_a_sweep_is_that_of_the_twin(
    size: tuple[int, int], radius: int, best: int, sources: int, isa: str
) -> None:
    """Oracle: the float64 twin; pixels with two highest planes equal to rounding are left out."""
    scene = Scene(*size)
    views = [view for view, _ in shots(scene, 0, 8, -8, 14)[: sources + 1]]
    options = {**RANGE, "planes": 17, "radius": radius, "best": best, "noise": 2.0}
    found = sweep(views[0], views[1:], **options)
    wanted = twin.sweep(views[0], views[1:], **options)
    np.testing.assert_allclose(
        found.contrast[radius:-radius, radius:-radius],
        wanted.contrast[radius:-radius, radius:-radius],
        atol=2e-3,
    )
    same = np.abs(found.score - wanted.score) < 1e-4
    assert same.mean() > 0.995
    np.testing.assert_allclose(found.second_best[same], wanted.second_best[same], atol=1e-3)
    off = np.abs(found.inverse_depth - wanted.inverse_depth)[same]
    assert np.quantile(off, 0.995) < 1e-4


def test_depth_is_found(isa: str) -> None:
    """Oracle: the traced depth of a wall and a ball."""
    scene = Scene(200, 150)
    (reference, truth), *others = shots(scene, 0, 7, -7, 12, -12)
    found = sweep(reference, [view for view, _ in others], **RANGE, planes=48)
    sure = (found.score > 0.8) & (found.second_best < 0.85 * found.score)
    error = np.abs(found.inverse_depth / truth - 1)[sure]
    assert sure.mean() > 0.5
    assert np.median(error) < 0.004 and np.mean(error < 0.02) > 0.95


def test_threads_change_no_bit(isa: str) -> None:
    """Oracle: one thread."""
    views = shots(Scene(130, 101), 0, 8, -8)
    pictures = [view for view, _ in views]
    one = sweep(pictures[0], pictures[1:], **RANGE, planes=20, threads=1)
    many = sweep(pictures[0], pictures[1:], **RANGE, planes=20, threads=5)
    for name in ("inverse_depth", "score", "second_best", "contrast"):
        assert getattr(one, name).tobytes() == getattr(many, name).tobytes()
    maps = [depth.astype(np.float32) for _, depth in views]
    pairs = list(zip(pictures[1:], maps[1:], strict=True))
    checks = [check(pictures[0], maps[0], pairs, threads=n) for n in (1, 5)]
    assert checks[0].inverse_depth.tobytes() == checks[1].inverse_depth.tobytes()


def test_flat_windows_score_low() -> None:
    """Oracle: a wall without texture, which has low scores at any noise."""
    scene = Scene(96, 72, flat=True)
    rng = np.random.default_rng(0)
    views = []
    for view, _ in shots(scene, 0, 8, -8):
        noisy = np.clip(view.grey + np.rint(rng.normal(0, 1, view.grey.shape)), 0, 255)
        views.append(replace(view, grey=noisy.astype(np.uint8)))
    found = sweep(views[0], views[1:], **RANGE, planes=32)
    wall = found.contrast < 2
    assert wall.mean() > 0.2
    assert (found.score[wall] > 0.6).mean() < 0.01


def test_one_place_shows_no_depth() -> None:
    """Oracle: a camera that only turned, for which all planes are equal, so that none is best."""
    scene = Scene(96, 72)
    reference, _ = scene.shot(scene.viewmat(0))
    turned = np.eye(4)
    turned[:3, :3] = [[np.cos(0.1), 0, np.sin(0.1)], [0, 1, 0], [-np.sin(0.1), 0, np.cos(0.1)]]
    for viewmat in (reference.viewmat, turned @ reference.viewmat):
        other, _ = scene.shot(viewmat)
        found = sweep(reference, [other, other], **RANGE, planes=16)
        assert (found.inverse_depth > 0).mean() < 0.2
        clear = (found.score > 0.6) & (found.second_best < 0.85 * found.score)
        assert not (clear & (found.inverse_depth == 0)).any()


def test_a_check_is_that_of_the_twin() -> None:
    """Oracle: the float64 twin, with depths that are right, wrong, and not finite."""
    (view, truth), *others = shots(Scene(61, 47), 0, 7, -9, 13)
    rng = np.random.default_rng(1)

    def spoilt(depth: np.ndarray) -> np.ndarray:
        factor = rng.choice([0.0, 0.7, 0.995, 1.0, 1.008, 1.4, np.nan], depth.shape)
        return (depth * factor).astype(np.float32)

    mine = spoilt(truth)
    witnesses = [(other, spoilt(depth)) for other, depth in others]
    found, wanted = check(view, mine, witnesses), twin.check(view, mine, witnesses)
    assert (found.agree == wanted.agree).mean() > 0.998
    assert (found.contradict == wanted.contradict).mean() > 0.998
    same = found.agree == wanted.agree
    np.testing.assert_allclose(found.inverse_depth[same], wanted.inverse_depth[same], rtol=1e-4)
    assert (found.agree >= 2).any() and (found.contradict >= 1).any()
    assert np.isfinite(found.inverse_depth).all()


def test_invalid_arguments_are_refused() -> None:
    """Oracle: the documentation of the library, csrc/include/gscore.h."""
    views = [view for view, _ in shots(Scene(33, 25), 0, 8)]
    good = {**RANGE, "planes": 8}
    sweep(views[0], views[1:], **good)
    for change in (
        {"planes": 2}, {"planes": 1025}, {"radius": 0}, {"radius": 8}, {"best": 0}, {"noise": 0.0},
        {"farthest": 0.4}, {"farthest": -1.0}, {"nearest": float("nan")},
        {"nearest": float("inf")}, {"threads": -1},
    ):  # fmt: skip
        with pytest.raises(ShapeError):
            sweep(views[0], views[1:], **(good | change))
    with pytest.raises(ShapeError, match="sources"):
        sweep(views[0], [], **good)
    with pytest.raises(ShapeError, match="sources"):
        sweep(views[0], views[1:] * 9, **good)
    with pytest.raises(ShapeError, match="finite"):
        sweep(views[0], [replace(views[1], K=views[1].K * np.nan)], **good)
    with pytest.raises(ShapeError, match="grey"):
        sweep(replace(views[0], grey=views[0].grey[:, ::2]), views[1:], **good)
    with pytest.raises(ShapeError, match="px per side"):
        sweep(replace(views[0], grey=np.zeros((1, 33), np.uint8)), views[1:], **good)
    with pytest.raises(ShapeError, match="inverse_depth"):
        check(views[0], np.zeros((25, 33)), [])
    with pytest.raises(ShapeError, match="negative"):
        check(views[0], np.zeros((25, 33), np.float32), [], pixels=-1)


def test_a_sweep_can_be_cancelled() -> None:
    """Oracle: a flag set before the call."""
    views = [view for view, _ in shots(Scene(33, 25), 0, 8)]
    flag = CancelFlag()
    flag.set()
    with pytest.raises(Cancelled):
        sweep(views[0], views[1:], **RANGE, planes=8, cancel=flag)
