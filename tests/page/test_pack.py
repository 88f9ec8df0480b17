"""Splats packed for a page; oracle: the splats before, and the steps that were promised."""

from dataclasses import replace

import numpy as np
import pytest

from gscore import Splats, render
from gscore.page.pack import (
    ALPHABET,
    COLOR_STEP,
    PAGE_BYTES,
    PLACE_LEVELS,
    SIZE_STEP,
    ascii85,
    ascii85_length,
    pack,
    unpack,
)
from gscore.sh import sh0_to_rgb
from gscore.transforms import quat_to_rotmat


def cloud(count: int, degree: int, seed: int = 3) -> Splats:
    """Splats on a wavy sheet, with what trainings leave: few large, most small, colours alike."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-1, 1, (count, 2))
    height = 0.3 * np.sin(4 * place[:, 0]) * np.cos(3 * place[:, 1])
    rest = (degree + 1) ** 2 - 1
    return Splats(
        means=np.column_stack([place, height]).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        scales=rng.normal(-4.5, 0.7, (count, 3)).astype(np.float32),
        opacities=rng.normal(1, 2, count).astype(np.float32),
        sh0=(np.sin(3 * place[:, :1, None]) + rng.normal(0, 0.3, (count, 1, 3))).astype(np.float32),
        shN=rng.laplace(0, 0.02, (count, rest, 3)).astype(np.float32),
    )


def matched(splats: Splats, found: Splats) -> np.ndarray:
    """For each splat found, the one it was: the nearest by place."""
    from scipy.spatial import KDTree

    return KDTree(splats.means).query(found.means)[1]


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_each_number_is_within_half_a_step(degree: int) -> None:
    """Oracle: the steps, for every splat; all harmonics are there."""
    splats = cloud(4000, degree)
    packed = pack(splats)
    found = unpack(packed)
    kept = splats.subset(matched(splats, found))
    assert len(found) == packed.head["count"] and found.sh_degree == degree
    side = 2.0  # of the whole cloud, larger than any block's
    assert np.abs(found.means - kept.means).max() <= 0.51 * side / (PLACE_LEVELS - 1)
    assert np.abs(found.scales - kept.scales).max() <= 0.51 * SIZE_STEP
    alpha = [1 / (1 + np.exp(-one.opacities.astype(np.float64))) for one in (found, kept)]
    assert np.abs(alpha[0] - alpha[1]).max() <= 0.51 / 255
    colors = [sh0_to_rgb(one.sh0.astype(np.float64)) for one in (found, kept)]
    assert np.linalg.norm(colors[0] - colors[1], axis=2).max() <= 0.51 * 3**0.5 * COLOR_STEP
    turns = quat_to_rotmat(found.quats.astype(np.float64))
    turns = turns @ quat_to_rotmat(kept.quats.astype(np.float64)).transpose(0, 2, 1)
    cosine = (np.trace(turns, axis1=1, axis2=2) - 1) / 2
    # Three components off by half a step each, and the largest, 1/2 at least, as much as follows.
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 2.3
    if degree:
        step = packed.head["rest_step"]
        off = np.linalg.norm(found.shN - kept.shN, axis=2)
        assert off.max() <= 0.51 * 3**0.5 * step < 0.3


def test_degree_4_is_shown_as_3() -> None:
    """Oracle: the page of the same splats without their last nine coefficients, to the byte."""
    splats = cloud(500, 4)
    less = replace(splats, shN=splats.shN[:, :15].copy())
    assert pack(splats) == pack(less) and unpack(pack(splats)).sh_degree == 3


@pytest.mark.parametrize(("count", "degree"), [(3000, 0), (30_000, 1), (30_000, 2), (30_000, 3)])
def test_twenty_bytes_a_splat_are_enough(count: int, degree: int) -> None:
    """Oracle: the length of the text; and harmonics get what is left: less of it, larger steps."""
    splats = cloud(count, degree)
    packed = pack(splats)
    text = ascii85(packed.body)
    assert len(text) == packed.text_bytes <= PAGE_BYTES * packed.head["count"]
    if degree:
        assert packed.text_bytes > 0.9 * PAGE_BYTES * packed.head["count"]
        assert pack(splats, budget=18).head["rest_step"] > packed.head["rest_step"]


def test_invisible_splats_are_left_out() -> None:
    """Oracle: the renders before and after leaving out, bit for bit."""
    splats = cloud(500, 1)
    faint = splats.opacities.copy()
    faint[::5] = -6.0  # 1/404
    means = splats.means.copy()
    means[3] = np.nan
    splats = replace(splats, opacities=faint, means=means)
    packed = pack(splats)
    gone = (faint == -6.0) | np.isnan(means[:, 0])
    assert packed.head["count"] == np.count_nonzero(~gone)
    K, viewmat = np.array([[60, 0, 32], [0, 60, 24], [0, 0, 1.0]]), np.eye(4)
    viewmat[2, 3] = 3.0
    before, after = (render(s, K, viewmat, 64, 48).rgb for s in (splats, splats.subset(~gone)))
    assert np.array_equal(before, after)


@pytest.mark.parametrize("count", [1, 3, 255, 256, 257, 3000])
@pytest.mark.parametrize("far", [1e3, 1e6, 3e38])
def test_any_number_of_splats(count: int, far: float) -> None:
    """Oracle: the places, at the borders of a block; a far splat takes nothing from the others."""
    splats = replace(cloud(count, 3), opacities=np.full(count, 3, np.float32))
    splats.means[0] = [far, -far, 0]
    found = unpack(pack(splats))
    assert len(found) == count
    assert np.isfinite(found.means).all()
    beyond = np.abs(found.means[:, 0]) > far / 2
    assert np.count_nonzero(beyond) == 1
    assert found.means[beyond][0] == pytest.approx(splats.means[0])
    if count > 1:
        assert _displacement(splats.means[1:], found.means[~beyond]).max() < 2 / 1000


@pytest.mark.parametrize("far", [10.0, 1000.0, 1e7])
def test_far_places_are_as_exact_as_seen_from_the_middle(far: float) -> None:
    """Oracle: the displacement over the distance, for a scene in a sky, and for two scenes of which
    each is far from the other; the budget of 20 bytes, most of which a sky may not take."""
    rng = np.random.default_rng(5)
    near, sky = cloud(20_000, 3), cloud(2_000, 3, seed=8)
    away = rng.normal(size=(2000, 3)) * rng.uniform(1, far, (2000, 1))
    other = cloud(5_000, 3, seed=9)
    skies = joined(near, replace(sky, means=away.astype(np.float32)))
    pairs = joined(near, replace(other, means=other.means + np.float32(far)))
    for splats in (skies, pairs):
        splats = replace(splats, opacities=np.full(len(splats), 3, np.float32))
        packed = pack(splats)
        found = unpack(packed)
        assert packed.text_bytes <= PAGE_BYTES * len(splats)
        moved = _displacement(splats.means, found.means)
        distance = np.maximum(np.linalg.norm(found.means, axis=1), 1)
        assert (moved / distance).max() < 2 / 1000


def joined(one: Splats, other: Splats) -> Splats:
    """Both, as one."""
    return Splats(
        **{k: np.concatenate([v, vars(other)[k]]) for k, v in vars(one).items()},
    )


def _displacement(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """[N] of each place after, to the nearest before, where each of those was found."""
    from scipy.spatial import KDTree

    away, at = KDTree(before).query(after)
    assert len(before) == len(after)
    assert KDTree(after).query(before)[0].max() < 2 * max(away.max(), 1e-6) and len(at)
    return away


def test_empty_model_is_packed() -> None:
    """Oracle: no splats."""
    found = unpack(pack(cloud(10, 2).subset(np.zeros(10, bool))))
    assert len(found) == 0 and found.sh_degree == 2


@pytest.mark.parametrize("length", [0, 1, 4, 5, 1003])
def test_letters_mean_the_same_to_others(length: int) -> None:
    """Oracle: base64.b85encode of Python, whose alphabet is exchanged letter by letter."""
    import base64

    raw = np.random.default_rng(length).integers(0, 256, length, np.uint8).tobytes()
    theirs = (
        b"0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz!#$%&()*+-;<=>?@^_`{|}~"
    )
    text = ascii85(raw)
    assert len(text) == ascii85_length(length)
    mine = text.translate(str.maketrans(ALPHABET, theirs.decode()))
    assert base64.b85decode(mine)[:length] == raw
    assert not set(ALPHABET) & set("<>&\"'\\` ") and len(set(ALPHABET)) == 85


@pytest.mark.parametrize("part", ["means", "quats", "scales", "opacities", "sh0", "shN"])
@pytest.mark.filterwarnings("error")
def test_numbers_at_the_ends_of_float32(part: str) -> None:
    """Oracle: no warning of numpy; rotations as of quaternions of usual length."""
    splats = cloud(600, 3)
    wild = replace(splats, quats=np.ldexp(splats.quats, 100))
    values = getattr(wild, part).reshape(600, -1)
    values[::50], values[1::50] = 3e38, -3e38
    found = unpack(pack(wild))
    assert len(found) > 0
