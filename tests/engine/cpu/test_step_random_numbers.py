"""Dropout and noise of a step; oracle: the twin's random numbers of its seed, step, row, model."""

import numpy as np
import pytest

from gscore.engine.base import DROPOUT_STREAM, NOISE_STREAM, STREAMS, StepPhoto
from gscore.engine.cpu.engine import CpuEngine
from gscore.engine.cpu.model import CpuModel
from gscore.engine.cpu.splat_terms import GATE_OPACITY, GATE_SHARPNESS
from gscore.raster.reference import random_numbers as twin
from gscore.splats import PARAMETERS, Splats
from gscore.stress.capture import ToyPhotos
from tests.engine.test_contract import COUNTERS, columns_of, request_of

RATES = dict.fromkeys(PARAMETERS, 0.0)
KEY = {"seed": 2**40 + 9, "step": 3}


def after_a_step(photos: ToyPhotos, splats: Splats, **options: object) -> CpuModel:
    """The model of these splats after step 3 at learning rates of 0."""
    engine = CpuEngine(threads=1)
    model = engine.model(columns_of(splats), counters=COUNTERS)
    engine.put(0, StepPhoto(image=photos.image(0)))
    options = {"rates": RATES, "seed": KEY["seed"], **options}
    engine.step(model, request_of(photos, 0, KEY["step"], **options)).result()
    return model


@pytest.mark.parametrize("place", [0, 2])
def test_dropped_splats_are_those_of_the_twin(
    photos: ToyPhotos, known_splats: Splats, place: int
) -> None:
    """Oracle: blocks of rows with a uniform number below the rate get no gradient, so no moment."""
    model = after_a_step(photos, known_splats, place=place, drop_rate=0.4)
    block = (np.arange(len(model)) + KEY["step"] % 16) // 16
    words = twin.row_words(block, stream=STREAMS * place + DROPOUT_STREAM, **KEY)
    dropped = twin.uniform(words) < np.float32(0.4)
    moved = model.save()["m1/opacities"] != 0
    whole = after_a_step(photos, known_splats).save()["m1/opacities"] != 0
    assert 0.2 < dropped.mean() < 0.6 and whole.mean() > 0.9
    assert not moved[dropped].any()
    assert moved[~dropped & whole].mean() > 0.9


@pytest.mark.parametrize("place", [0, 1])
def test_noise_is_that_of_the_twin(photos: ToyPhotos, known_splats: Splats, place: int) -> None:
    """Oracle: covariance @ normal numbers of the row, times gate and weight; opaque rows stay."""
    opacities = np.full(len(known_splats), -4.0, np.float32)
    opacities[::3] = 2
    quats = np.tile(np.array([1, 0, 0, 0], np.float32), (len(known_splats), 1))
    faint = Splats(
        **columns_of(known_splats) | {"opacities": opacities, "quats": quats},
    )
    model = after_a_step(photos, faint, place=place, noise=0.5)
    words = twin.row_words(np.arange(len(model)), stream=STREAMS * place + NOISE_STREAM, **KEY)
    normal = np.array([twin.normal(tuple(row)) for row in words.tolist()])
    opacity = 1 / (1 + np.exp(-opacities.astype(np.float64)))
    gate = 1 / (1 + np.exp(GATE_SHARPNESS * (opacity - GATE_OPACITY)))
    expected = 0.5 * gate[:, None] * np.exp(2.0 * faint.scales) * normal
    expected[::3] = 0
    found = model.column("means").astype(np.float64) - faint.means
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=3e-7)
    assert np.abs(found).max() > 1e-5
