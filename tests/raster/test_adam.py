"""The native Adam; oracle: the update rule in float64, every row at every step."""

import numpy as np
import pytest
import torch

from gscore.errors import ShapeError
from gscore.raster import adam
from gscore.raster.autograd import RasterAux, rasterize

BETA1, BETA2, EPS = 0.9, 0.999, 1e-15


class Twin:
    """Dense Adam in float64."""

    def __init__(self, value: np.ndarray) -> None:
        self.value = value.astype(np.float64)
        self.m, self.v = np.zeros_like(self.value), np.zeros_like(self.value)
        self.t = 0

    def step(self, grad: np.ndarray, rate: float) -> None:
        self.t += 1
        self.m = BETA1 * self.m + (1 - BETA1) * grad
        self.v = BETA2 * self.v + (1 - BETA2) * grad * grad
        m, v = self.m / (1 - BETA1**self.t), self.v / (1 - BETA2**self.t)
        self.value -= rate * m / (np.sqrt(v) + EPS)


def slot_of(value: np.ndarray, *, skips: bool) -> adam.Slot:
    """A float32 copy of `value` with zero moments before its first step."""
    tensor = torch.from_numpy(value.astype(np.float32))
    n = len(value)
    late = adam.Skips(
        torch.zeros(n, dtype=torch.uint8),
        torch.zeros(n, dtype=torch.uint8),
        torch.zeros(adam.PENDING_SIZE, dtype=torch.float64),
    )
    zeros = [torch.zeros_like(tensor) for _ in range(3)]
    return adam.Slot(tensor, *zeros, rate=0.0, step=0, skips=late if skips else None)


def points(n: int, rng: np.random.Generator) -> dict[str, torch.Tensor]:
    """Means in a box around the origin, small log scales."""
    return {
        "means": torch.from_numpy(rng.uniform(-2, 2, (n, 3))).float(),
        "scales": torch.from_numpy(rng.normal(size=(n, 3)) * 0.5 - 3).float(),
    }


def relative(found: torch.Tensor, expected: np.ndarray) -> float:
    """Largest distance of two rows, relative to the length of the expected one."""
    rows = found.double().numpy().reshape(len(found), -1) - expected.reshape(len(found), -1)
    lengths = np.linalg.norm(expected.reshape(len(found), -1), axis=1)
    return float((np.linalg.norm(rows, axis=1) / lengths).max())


@pytest.mark.usefixtures("isa")
@pytest.mark.parametrize("rest", [3, 15])
def test_rows_that_skip_steps_end_where_dense_adam_takes_them(rest: int) -> None:
    """Oracle: the twin, 1,000 steps in which rows come and go, some for longer than the length of
    the table of skipped steps, some once and never again, some never."""
    rng = np.random.default_rng(rest)
    n = 90
    first = rng.normal(size=(n, rest, 3)).astype(np.float32)
    late, dense, twin = slot_of(first, skips=True), slot_of(first, skips=False), Twin(first)
    places = points(n, rng)
    chance = rng.choice([0.0, 0.002, 0.02, 0.5, 0.95], n)
    for step in range(1, 1001):
        shown = rng.random(n) < chance
        if step in (3, 400):
            shown[:30] = True
        shown[-5:] = False
        grad = rng.normal(size=first.shape) * 10.0 ** rng.uniform(-6, 1, (n, 1, 1))
        grad = np.where(shown[:, None, None], grad, 0).astype(np.float32)
        rate = 5e-3 * 0.995**step
        twin.step(grad.astype(np.float64), rate)
        radii = torch.from_numpy(shown.astype(np.int32))
        for slot in (late, dense):
            slot.rate, slot.step = rate, step
            slot.grad += torch.from_numpy(grad) if slot.skips else 0
            if slot.skips is None:
                slot.grad.copy_(torch.from_numpy(grad))
            assert adam.step([slot], radii) == 0
        if step % 250 == 0:
            adam.catch_up(late, places)
        assert not late.grad.any()
    assert torch.equal(late.value[-5:], torch.from_numpy(first[-5:]))
    for slot in (late, dense):
        assert relative(slot.value, twin.value) < 2e-6
        moved = twin.v.reshape(n, -1).any(axis=1)
        assert relative(slot.moment2[moved], twin.v[moved]) < 2e-5
    alive = np.abs(twin.m).reshape(n, -1).max(axis=1) > 1e-30
    assert relative(late.moment1[alive], twin.m[alive]) < 2e-5


def test_the_table_is_the_sum_of_the_steps_that_were_skipped() -> None:
    """Oracle: the sum over j of lr (beta1 / sqrt(beta2))^j sqrt(1 - beta2^t) / (1 - beta1^t)."""
    slot = slot_of(np.ones((1, 3)), skips=True)
    assert slot.skips is not None
    rates = [1e-3 * 0.9**i for i in range(300)]
    for step, rate in enumerate(rates, start=1):
        slot.step, slot.rate = step, np.float32(rate).item()
        adam.step([slot], torch.zeros(1, dtype=torch.int32))
    for k in (1, 2, 100, 255):
        steps = range(300 - k + 1, 301)
        expected = sum(
            np.float32(rates[t - 1])
            * (BETA1 / BETA2**0.5) ** (t - (300 - k))
            * np.sqrt(1 - BETA2**t)
            / (1 - BETA1**t)
            for t in steps
        )
        assert slot.skips.factors[k].item() == pytest.approx(expected, rel=1e-9)


def test_looking_changes_nothing_and_shows_what_settling_gives() -> None:
    """Oracle: bits before and after, and the values left by the call in place."""
    rng = np.random.default_rng(0)
    slot, places = slot_of(rng.normal(size=(50, 3, 3)), skips=True), points(50, rng)
    for step in range(1, 20):
        slot.rate, slot.step = 1e-2, step
        slot.grad.normal_()
        radii = torch.from_numpy((rng.random(50) < 0.4).astype(np.int32))
        slot.grad[radii == 0] = 0
        adam.step([slot], radii)
    assert slot.skips is not None and slot.skips.pending.any()
    state = (slot.value, slot.moment1, slot.moment2, slot.skips.pending, slot.skips.visible)
    before = [t.clone() for t in state]
    shown = torch.full_like(slot.value, torch.nan)
    adam.catch_up(slot, places, out=shown)
    assert all(torch.equal(a, b) for a, b in zip(before, state, strict=True))
    adam.catch_up(slot, places)
    assert torch.equal(slot.value, shown)
    assert not torch.equal(slot.value, before[0])
    assert not slot.skips.pending.any()


@pytest.mark.usefixtures("isa")
def test_whatever_a_view_draws_is_synced_first() -> None:
    """Oracle: the radii of the rasterizer, for cameras inside and outside of the cloud and large
    splats; rows far from the picture stay lazy."""
    rng = np.random.default_rng(3)
    n, waiting = 4000, 0
    for trial in range(12):
        places = points(n, rng)
        places["scales"] += rng.uniform(0, 3)
        slot = slot_of(rng.normal(size=(n, 3, 3)), skips=True)
        assert slot.skips is not None
        slot.step, slot.rate = 1, 1e-2
        slot.skips.pending.fill_(1)
        slot.skips.factors[1:] = 1.0
        Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        viewmat = torch.eye(4)
        viewmat[:3, :3] = torch.from_numpy(Q * np.sign(np.linalg.det(Q)))
        viewmat[2, 3] = trial % 4
        K = torch.tensor([[60.0 + 10 * trial, 0, 25.0], [0, 70, 40.0 - 5 * trial], [0, 0, 1]])
        aux = RasterAux()
        rasterize(
            places["means"],
            torch.from_numpy(rng.normal(size=(n, 4))).float(),
            places["scales"],
            torch.full((n,), 12.0),
            torch.zeros(n, 1, 3),
            torch.zeros(n, 0, 3),
            viewmat,
            K,
            80,
            60,
            raw=True,
            aux=aux,
        )
        assert aux.radii is not None and (aux.radii > 0).any()
        adam.catch_up(slot, places, adam.Frustum(viewmat, K, 80, 60, 0.01))
        assert not slot.skips.pending[aux.radii > 0].any()
        waiting += int(slot.skips.pending.sum())
    assert waiting > n


def test_gradients_gather_until_a_step() -> None:
    """Oracle: one step with the sum; rows visible in any of the calls move, others wait."""
    first = np.ones((4, 3, 3))
    slot, twin = slot_of(first, skips=True), Twin(first)
    assert slot.skips is not None
    gathered = np.zeros((4, 3, 3))
    slot.rate, slot.skips.wait = 0.1, True
    for call, row in enumerate((0, 1, 0, 2)):
        if call == 3:
            slot.step, slot.skips.wait = 1, False
        slot.grad[row] += call + 1.0
        gathered[row] += call + 1.0
        radii = torch.zeros(4, dtype=torch.int32)
        radii[row] = 5
        adam.step([slot], radii)
    twin.step(gathered, 0.1)
    np.testing.assert_allclose(slot.value.numpy(), twin.value, rtol=1e-6)
    assert slot.skips.pending.tolist() == [0, 0, 0, 1]
    assert not slot.skips.visible.any() and not slot.grad.any()


@pytest.mark.usefixtures("isa")
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_rows_that_are_not_finite_count_as_zero_everywhere(bad: float) -> None:
    """Oracle: bits of a run in which the row has zero gradients in all tensors."""
    rng = np.random.default_rng(1)
    results = []
    for poisoned in (True, False):
        slots = [slot_of(np.ones((1500, k)), skips=k == 9) for k in (3, 1, 9)]
        rng = np.random.default_rng(1)
        for step in (1, 2):
            for i, slot in enumerate(slots):
                slot.rate, slot.step = 0.1, step
                slot.grad.copy_(torch.from_numpy(rng.normal(size=slot.grad.shape)))
                if step == 2:
                    slot.grad[[7, 1499]] = 0
                    if poisoned and i == 0:
                        slot.grad[7, 2] = bad
                    if poisoned and i == 2:
                        slot.grad[[7, 1499], 8] = bad
            assert adam.step(slots, None) == (2 if poisoned and step == 2 else 0)
        results.append([t for s in slots for t in (s.value, s.moment1, s.moment2)])
    assert all(torch.equal(a, b) for a, b in zip(*results, strict=True))
    assert all(torch.isfinite(t).all() for t in results[0])


@pytest.mark.usefixtures("isa")
@pytest.mark.parametrize("size", [0.0, 1e-45, 1e-30, 1e-19, 1e19, 3e38])
def test_tiny_and_huge_gradients_stay_finite(size: float) -> None:
    """Oracle: Adam's step of at most about lr, for any unit of the gradient."""
    slots = [slot_of(np.ones((20, 9)), skips=skips) for skips in (False, True)]
    for step in range(1, 11):
        for slot in slots:
            slot.rate, slot.step = 1e-2, step
            slot.grad.fill_(size if step % 3 else -size)
        shown = torch.full((20,), int(step % 4 > 0), dtype=torch.int32)
        if step % 4 == 0:
            slots[1].grad.zero_()
        assert adam.step(slots, shown) == 0
    adam.catch_up(slots[1], points(20, np.random.default_rng(0)))
    for slot in slots:
        for tensor in (slot.value, slot.moment1, slot.moment2):
            assert torch.isfinite(tensor).all()
        moved = (slot.value - 1).abs().max()
        assert moved < 0.11
        assert size < 1e-14 or moved > 0.01


@pytest.mark.usefixtures("isa")
def test_same_bits_for_any_number_of_threads() -> None:
    """Oracle: bit equality of all state, from 1 to 64 threads."""
    seen = []
    for threads in (1, 2, 3, 7, 64):
        rng = np.random.default_rng(0)
        slots = [slot_of(rng.normal(size=(5000, k)), skips=k == 9) for k in (3, 9)]
        bad = 0
        for step in range(1, 8):
            radii = torch.from_numpy(rng.integers(0, 3, 5000).astype(np.int32))
            for slot in slots:
                slot.rate, slot.step = 1e-2, step
                slot.grad.copy_(torch.from_numpy(rng.normal(size=slot.grad.shape)))
                slot.grad[radii == 0] = 0
            slots[0].grad[step * 600] = torch.nan
            bad += adam.step(slots, radii, threads=threads)
        adam.catch_up(slots[1], points(5000, rng), threads=threads)
        tensors = [t for s in slots for t in (s.value, s.moment1, s.moment2)]
        seen.append((bad, [t.numpy().tobytes() for t in tensors]))
    assert seen[0][0] == 7
    assert all(result == seen[0] for result in seen)


def test_wrong_tensors_are_refused() -> None:
    """Oracle: the message, which names the tensor, its expected and its actual type or shape."""
    slot = slot_of(np.ones((4, 3)), skips=True)
    slot.step = 1
    assert slot.skips is not None
    with pytest.raises(ShapeError, match=r"radii must be \[4\] int32, .* got \[4\] float32"):
        adam.step([slot], torch.zeros(4))
    slot.skips.pending = torch.zeros(5, dtype=torch.uint8)
    with pytest.raises(ShapeError, match=r"pending must be \[4\] uint8.* got \[5\]"):
        adam.step([slot], None)
    slot.skips.pending = torch.zeros(4, dtype=torch.uint8)
    slot.grad = torch.zeros(3, 4).T
    with pytest.raises(ShapeError, match=r"grad must be \[4, 3\].* contiguous"):
        adam.step([slot], None)
    slot.grad = torch.zeros(4, 3)
    slot.step = 0
    with pytest.raises(ShapeError, match="step counts from 1"):
        adam.step([slot], None)
    dense = slot_of(np.ones((4, 3)), skips=False)
    dense.step = 1
    with pytest.raises(ShapeError, match="must not be GS_ADAM_ALL"):
        adam.catch_up(dense, points(4, np.random.default_rng(0)))
