"""Data for the graphics card. Oracles are named in the tests."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from addon.core import Splats, transform_splats
from addon.live import atlas, order
from addon.live.level import BUDGET, FEWEST, STILL, Detail, Level
from addon.process.background_task import Latest
from addon.render import mesh_copies
from addon.render.mesh_copies import HIDDEN, SELECTED
from gscore import sh
from tests.addon import splat_scenes as lab


def similarity(scale: float, seed: int = 0) -> np.ndarray:
    """A rotation, a scale and a translation."""
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    matrix = np.eye(4)
    matrix[:3, :3] = turn * np.sign(np.linalg.det(turn)) * scale
    matrix[:3, 3] = rng.normal(size=3)
    return matrix


def test_an_atlas_holds_every_splat_once():
    """Oracle: the splats, in float64: means, covariances R S S R^T, sigmoids."""
    parts = [lab.blob(1500, seed=1), lab.blob(700, seed=2)]
    made = atlas.build(parts)
    assert len(made) == 2200
    rows = made.texels.reshape(-1, atlas.TEXELS, 4)
    assert not rows[2200:].any()
    for number, splats in enumerate(parts):
        mine = np.flatnonzero(made.part == number)
        assert sorted(made.index[mine]) == list(range(len(splats)))
        index = made.index[mine]
        np.testing.assert_array_equal(rows[mine, 0, :3], splats.means[index])
        alpha = 1 / (1 + np.exp(-splats.opacities[index].astype(np.float64)))
        np.testing.assert_allclose(rows[mine, 0, 3], alpha, rtol=1e-5)
        q = splats.quats[index].astype(np.float64)
        w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
        long = np.stack(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        ).transpose(2, 0, 1)
        axes = long * np.exp(splats.scales[index].astype(np.float64))[:, None]
        want = axes @ axes.transpose(0, 2, 1)
        got = np.concatenate([rows[mine, 1], rows[mine, 2, :2]], 1)
        upper = np.stack(
            [want[:, i, j] for i, j in [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]], 1
        )
        np.testing.assert_allclose(got, upper, atol=1e-5 * upper.max())
        assert (rows[mine, 2, 2] == number).all()


def test_the_most_seen_come_first():
    """Oracle: a hand-made object of three splats: large and opaque, small, large and faint."""
    splats = lab.blob(3)
    splats = Splats(
        **{n: getattr(splats, n) for n in ("means", "quats", "sh0", "shN")},
        scales=np.log([[1, 1, 1], [0.01, 0.01, 0.01], [1, 1, 1]]).astype(np.float32),
        opacities=np.array([3, 3, -3], np.float32),
    )
    assert atlas.build([splats]).index.tolist() == [0, 2, 1]


def test_marks_tint_and_hide():
    """Oracle: the same order without marks: hidden rows are missing, colours of selected ones are
    nearer to the tint, all others equal to the bit; the atlas is the same."""
    parts = [lab.blob(900, seed=1), lab.blob(300, seed=2)]
    made = atlas.build(parts)
    eye = order.Eye(viewmats=(np.eye(4), similarity(1.5)), orthographic=False)
    plain = order.arrange(made, eye, len(made))
    own = np.random.default_rng(0).integers(0, 4, 900).astype(np.uint8)
    got = order.arrange(made, eye, len(made), [own, None])
    bits = np.zeros(len(made), np.uint8)
    mine = made.part == 0
    bits[mine] = own[made.index[mine]]
    bits = bits[plain[:, 0].astype(int)]
    kept = (bits & HIDDEN) == 0
    np.testing.assert_array_equal(got[:, 0], plain[kept, 0])
    chosen = (bits[kept] & SELECTED) != 0
    assert 100 < chosen.sum() < 500
    np.testing.assert_array_equal(got[~chosen], plain[kept][~chosen])
    before, after = plain[kept][chosen, 1:], got[chosen, 1:]
    apart = np.linalg.norm(before - mesh_copies.TINT, axis=1)
    np.testing.assert_allclose(
        np.linalg.norm(after - mesh_copies.TINT, axis=1), 0.35 * apart, atol=1e-5
    )


def repainted(splats: Splats, rows: np.ndarray, *, fade: bool) -> Splats:
    """The same arrays, except for colours, and optionally opacities, of some rows."""
    sh0, opacities = splats.sh0.copy(), splats.opacities.copy()
    sh0[rows] += 0.7
    opacities[rows] -= 1.5 * fade
    return replace(splats, sh0=sh0, opacities=opacities)


@pytest.mark.parametrize("fade", [False, True])
def test_a_repainted_atlas_is_one_of_what_was_painted(fade):
    """Oracle: a new atlas, splat by splat; equal texels are shared, and the earlier atlas keeps its
    own."""
    parts = [lab.blob(1500, seed=1), lab.blob(700, seed=2)]
    made = atlas.build(parts)
    texels = made.texels.copy()
    now = [parts[0], repainted(parts[1], np.arange(20, 90), fade=fade)]
    got, differ = atlas.repainted(made, now)
    want = atlas.build(now)
    assert (got.texels is made.texels) == (not fade)
    np.testing.assert_array_equal(made.texels, texels)
    rows = got.texels.reshape(-1, atlas.TEXELS, 4)
    place = {(p, i): row for row, (p, i) in enumerate(zip(want.part, want.index, strict=True))}
    for row, key in enumerate(zip(got.part, got.index, strict=True)):
        wanted = want.texels.reshape(-1, atlas.TEXELS, 4)[place[key]]
        np.testing.assert_array_equal(rows[row], wanted)
    assert differ.sum() == 70 and got.parts == tuple(now)
    assert set(got.index[differ]) == set(range(20, 90)) and (got.part[differ] == 1).all()


def test_other_splats_are_no_repainted_ones():
    """Oracle: None after a change of an array other than colours, or of the number of objects."""
    parts = [lab.blob(100)]
    made = atlas.build(parts)
    assert atlas.repainted(made, [replace(parts[0], means=parts[0].means.copy())]) is None
    assert atlas.repainted(made, [*parts, lab.blob(5)]) is None


def test_recoloured_entries_are_those_of_a_new_order():
    """Oracle: `arrange` of the repainted atlas, to the bit; splats are selected and hidden, too."""
    parts = [lab.blob(1500, seed=1), lab.blob(700, seed=2)]
    made = atlas.build(parts)
    eye = order.Eye(viewmats=(np.eye(4), similarity(1.5)), orthographic=False)
    own = np.random.default_rng(0).integers(0, 4, 700).astype(np.uint8)
    before = order.arrange(made, eye, 1800, [None, own])
    now = [repainted(p, np.arange(0, 600, 3), fade=True) for p in parts]
    painted, differ = atlas.repainted(made, now)
    got = order.recolored(before, painted, eye, differ, [None, own])
    np.testing.assert_array_equal(got, order.arrange(painted, eye, 1800, [None, own]))
    assert (got != before).any()


def test_newly_selected_splats():
    """Oracle: the bits, counted by hand."""
    before = np.array([0, SELECTED, HIDDEN, 0], np.uint8)
    after = np.array([SELECTED, 0, HIDDEN, 0], np.uint8)
    assert mesh_copies.reselected(before, after, 4).tolist() == [True, True, False, False]
    assert mesh_copies.reselected(None, after, 4) is None
    assert mesh_copies.reselected(None, after & np.uint8(SELECTED), 4).tolist() == [
        True,
        *[False] * 3,
    ]
    assert not mesh_copies.reselected(None, None, 4).any()


def test_more_than_float32_numbers_are_refused(monkeypatch):
    """Oracle: the message names both numbers."""
    monkeypatch.setattr(atlas, "MOST", 1000)
    with pytest.raises(ValueError, match=r"1,500 splats .* limit is 1,000"):
        atlas.build([lab.blob(1500)])


@pytest.mark.parametrize("orthographic", [False, True])
def test_order_and_colours_of_objects_with_transforms(orthographic):
    """Oracle: the splats transformed to the camera by `transform_splats`, which rotates the SH
    too."""
    parts = [lab.blob(900, seed=3), lab.blob(400, seed=4)]
    viewmats = (similarity(1.7, 5), similarity(0.4, 6))
    made = atlas.build(parts)
    eye = order.Eye(viewmats=viewmats, orthographic=orthographic)
    got = order.arrange(made, eye, len(made))
    assert sorted(got[:, 0]) == list(range(len(made)))
    there = [transform_splats(p, m) for p, m in zip(parts, viewmats, strict=True)]
    depths = np.array([there[p].means[i, 2] for p, i in zip(made.part, made.index, strict=True)])
    along = depths[got[:, 0].astype(int)]
    assert (np.diff(along) <= 1e-5).all() and np.ptp(along) > 0.5
    for row, *color in got[::37]:
        splats, i = there[made.part[int(row)]], made.index[int(row)]
        direction = np.array([0, 0, 1.0]) if orthographic else splats.means[i].astype(np.float64)
        basis = sh.sh_basis(2, direction / np.linalg.norm(direction))
        want = 0.5 + basis @ np.concatenate([splats.sh0[i], splats.shN[i]])
        np.testing.assert_allclose(color, np.maximum(want, 0), atol=2e-5)


def test_fewer_are_the_first_of_the_atlas():
    """Oracle: the order of all, without the other rows."""
    made = atlas.build([lab.blob(3000)])
    eye = order.Eye(viewmats=(similarity(1.0),), orthographic=False)
    full, few = (order.arrange(made, eye, n) for n in (10_000, 700))
    np.testing.assert_array_equal(few, full[full[:, 0] < 700])


def card_seconds(detail: Detail) -> float:
    """Time of a card that needs 100 ns per splat and 20 ms for the pixels of a whole view."""
    return 1e-7 * detail.count + 0.02 / detail.factor**2


def test_all_are_drawn_at_rest_and_less_on_the_move():
    """Oracle: the test's clock, and a card of known speed."""
    level, now, total = Level(), 100.0, 10**6
    whole = Detail(count=total, factor=1)
    assert level.detail(now, b"a", total) == whole  # opened: nothing moves
    assert level.measures
    level.took(card_seconds(whole))
    assert not level.measures and level.detail(now, b"a", total) == whole
    measured = 0
    for step in range(60):
        now += 0.02
        detail = level.detail(now, b"%d" % step, total)
        assert level.moving
        if level.measures:
            measured += 1
            level.took(card_seconds(detail))
    assert measured <= 8  # each is a wait
    assert detail.factor > 1 and FEWEST <= detail.count < total
    assert 0.5 * BUDGET < card_seconds(detail) < 1.2 * BUDGET
    assert level.detail(now + 0.1, b"59", total) == level.detail(now, b"59", total)
    assert level.rests_at == pytest.approx(now + STILL)
    assert level.detail(now + STILL, b"59", total) == whole and not level.moving
    assert level.detail(now + 9, b"x", 5).count == 5


def test_a_quick_card_draws_all_and_a_slow_one_a_little():
    """Oracle: the work of cards within the budget: everything, and nothing."""
    for seconds, want in ((BUDGET / 2, Detail(count=40_000, factor=1)),
                          (1.0, Detail(count=FEWEST, factor=3))):  # fmt: skip
        level, now = Level(), 0.0
        for step in range(100):
            now += 0.02
            detail = level.detail(now, b"%d" % step, 40_000)
            if level.measures:
                level.took(seconds)
        assert detail == want


def test_a_thread_answers_the_last_request():
    """Oracle: the requests; those between the first and the last are dropped."""
    begun, go = threading.Event(), threading.Event()

    def work(request: int) -> int:
        begun.set()
        assert go.wait(60)
        if request == 9:
            raise ValueError("Nine cannot be.")
        return 10 * request

    worker: Latest[int, int] = Latest(work, "test")
    worker.submit(1)
    assert begun.wait(60)
    for request in (2, 3, 4):
        worker.submit(request)
    answers = []
    go.set()
    until = time.monotonic() + 60
    while worker.busy and time.monotonic() < until:
        if worker.answer and worker.answer not in answers:
            answers.append(worker.answer)
        time.sleep(0.001)
    assert worker.answer == (4, 40) and worker.fresh and not worker.problem
    assert all(answer in ((1, 10), (4, 40)) for answer in answers)
    worker.submit(9)
    while worker.busy and time.monotonic() < until:
        time.sleep(0.001)
    assert worker.problem == "Nine cannot be." and worker.answer is None
    worker.close()
    worker.submit(5)
    assert not worker.busy
