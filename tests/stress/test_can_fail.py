"""A failure of every case: damage to its subject is detected. Oracle: the damage."""

import dataclasses

import numpy as np
import pytest

from gscore.raster import _native, native_library
from gscore.stress import capture, native, run_cases, select


def pixel(drawn):
    """One pixel of every picture, in the middle, is slightly wrong."""
    pictures = {}
    for name, picture in drawn.pictures.items():
        pictures[name] = picture.copy()
        pictures[name][picture.shape[0] // 2, picture.shape[1] // 2] += np.float32(2e-3)
    return dataclasses.replace(drawn, pictures=pictures)


def light_left(drawn):
    """Alpha is taken from the transmittance."""
    one = np.float32(1)
    rounded = one - (one - drawn.pictures["alpha"])
    return dataclasses.replace(drawn, pictures={**drawn.pictures, "alpha": rounded})


def slope(drawn):
    """Gradients are one per cent too long."""
    longer = {name: g * np.float32(1.01) for name, g in drawn.gradients.items()}
    return dataclasses.replace(drawn, gradients=longer)


def last_bit(drawn):
    """One number of the gradients, or else of the picture, has another last bit."""

    def nudged(arrays, name):
        array = arrays[name].copy()
        array.reshape(-1)[np.abs(array).argmax()] *= np.float32(1 + 2**-22)
        return {**arrays, name: array}

    if drawn.gradients and drawn.gradients["means"].any():
        return dataclasses.replace(drawn, gradients=nudged(drawn.gradients, "means"))
    return dataclasses.replace(drawn, pictures=nudged(drawn.pictures, "rgb"))


def not_finite(drawn):
    """The camera's gradient is not a number."""
    gradients = dict(drawn.gradients)
    if gradients:
        gradients["viewmat"] = gradients["viewmat"] * np.nan
    return dataclasses.replace(drawn, gradients=gradients)


def ghost(drawn):
    """A splat is drawn where nothing should be."""
    return dataclasses.replace(drawn, pictures={k: p + 1 for k, p in drawn.pictures.items()})


DRAWN = {
    "S01": slope,
    "S03": pixel,
    "S04": slope,
    "S05": pixel,
    "S06": pixel,
    "S07": not_finite,
    "S08": pixel,
    "S11": slope,
    "S12b": not_finite,
    "S13": pixel,
    "S14": slope,
    "S16": pixel,
    "S17": ghost,
    "S24": pixel,
    "S25": pixel,
    "S26": slope,
    "S26b": light_left,
    "S28": slope,
    "S35": pixel,
    "S36": pixel,
}
"""Damage to every rendering."""
NOW_AND_THEN = {"S10": pixel, "S12": last_bit, "S18": last_bit, "S19": slope, "S20": slope}
NOW_AND_THEN |= {"S15": pixel, "S29": pixel, "S31": last_bit, "S33": pixel}
"""The same to every other call, where calls are compared with each other."""


def outcomes_of(key):
    cases = [c for c in select(full=True) if c.key == key]
    assert len(cases) == 1
    return run_cases(cases, isas=[native_library.available_isas()[0]])


def fails(key):
    found = outcomes_of(key)
    return any(o.passed is False and not np.isnan(o.error) for o in found)


@pytest.mark.parametrize("key", sorted(DRAWN | NOW_AND_THEN))
def test_damage_is_found(key, monkeypatch):
    honest, calls = native.draw, []

    def damaged(*args, **options):
        drawn = honest(*args, **options)
        calls.append(key)
        if key in DRAWN:
            return DRAWN[key](drawn)
        return NOW_AND_THEN[key](drawn) if len(calls) % 2 == 0 else drawn

    monkeypatch.setattr(native, "draw", damaged)
    assert fails(key)
    assert calls


def test_wrong_gradients_of_stages_are_found(monkeypatch):
    from gscore.raster import reference

    honest = reference.conic

    def damaged(covars2d, eps2d):
        conics, compensation = honest(covars2d, eps2d)
        return conics + 1e-3 * (covars2d[:, 0, :1].detach() - covars2d[:, 0, :1]), compensation

    monkeypatch.setattr(reference, "conic", damaged)
    assert fails("S02")


def test_lost_coordinates_are_found(monkeypatch):
    """The far capture's points in float32, as if it had not been recentred first."""
    from gscore.stress import training

    def rounded(photos, **place):
        far = capture.moved(photos, **place)
        points = far.scene.points.points.astype(np.float32).astype(np.float64)
        cloud = dataclasses.replace(far.scene.points, points=points)
        return dataclasses.replace(far, scene=dataclasses.replace(far.scene, points=cloud))

    monkeypatch.setattr(training, "moved", rounded)
    assert fails("S09")


def test_training_that_learns_too_little_is_found(monkeypatch):
    from gscore.stress import training

    monkeypatch.setattr(training, "mean_psnr", lambda trainer, photos: 34.0)
    assert fails("S32")


def test_broken_trainings_are_found(monkeypatch):
    from gscore.stress import training

    honest = training.trained

    def damaged(config, photos):
        trainer = honest(config, photos)
        trainer.model.params["means"][0] = float("nan")
        return trainer

    monkeypatch.setattr(training, "trained", damaged)
    assert fails("S17b")


def test_a_coarse_exponential_is_found(monkeypatch):
    honest = _native.exp2
    monkeypatch.setattr(_native, "exp2", lambda x: honest(x) * np.float32(1 + 2**-21))
    assert fails("S21")


def test_a_wrong_loss_is_found(monkeypatch):
    from gscore.raster import loss

    honest = loss.image_loss
    monkeypatch.setattr(
        loss, "image_loss", lambda *a, **o: honest(*a, **{**o, "ssim_weight": 0.201})
    )
    assert fails("S22")


def test_wrong_metrics_are_found(monkeypatch):
    from gscore.metrics import image

    monkeypatch.setattr(image, "SSIM_C2", 0.031**2)
    assert fails("S34")


def test_wrong_alignment_is_found(monkeypatch):
    from gscore.stress import depth

    honest = depth.align_robust

    def damaged(*args, **options):
        fit = honest(*args, **options)
        return dataclasses.replace(fit, scale=fit.scale * 1.05)

    monkeypatch.setattr(depth, "align_robust", damaged)
    assert fails("S27")


def test_a_worn_optimizer_is_found(monkeypatch):
    from gscore.stress import optimizer

    monkeypatch.setattr(optimizer, "ADAM_BETA2", 0.9991)
    assert fails("S23")


@pytest.mark.parametrize("field", ["shN", "opacities", "scales"])
def test_broken_splats_of_a_long_training_are_found(field, monkeypatch):
    """In a short version of it, which is sound without the damage."""
    from gscore.stress import training

    honest = training.trainer_of
    monkeypatch.setattr(training, "LONG", 200)
    monkeypatch.setattr(training, "mean_psnr", lambda trainer, photos: 20.0)
    assert not fails("S30")

    def damaged(config, photos):
        trainer = honest(config, photos)
        splats = trainer.splats

        def broken():
            found = splats()
            array = getattr(found, field).copy()
            array.reshape(-1)[0] = 12.0 if field == "scales" else np.nan
            return dataclasses.replace(found, **{field: array})

        trainer.splats = broken
        return trainer

    monkeypatch.setattr(training, "trainer_of", damaged)
    assert fails("S30")


def test_a_long_training_that_unlearns_is_found(monkeypatch):
    from gscore.stress import training

    psnr = iter(np.linspace(40.0, 30.0, 40))
    monkeypatch.setattr(training, "LONG", 200)
    monkeypatch.setattr(training, "mean_psnr", lambda trainer, photos: float(next(psnr)))
    assert fails("S30")


def test_every_case_was_tried():
    tried = {"S02", "S09", "S17b", "S21", "S22", "S23", "S27", "S30", "S32", "S34"}
    assert {c.key for c in select(full=True)} == set(DRAWN) | set(NOW_AND_THEN) | tried
