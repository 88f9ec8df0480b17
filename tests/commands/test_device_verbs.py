"""`--device` of the verbs that measure; oracle: the draws that a fake library counts."""

import json
import shutil

import numpy as np
import pytest

from gscore.io.ply.splats import write_splats
from gscore.raster.gpu import choice, gpu_raster, library, verdict
from gscore.raster.gpu.devices import find_devices
from gscore.raster.gpu.verdict import DeviceVerdict, keep_verdict
from gscore.splats import Splats
from tests.gpu.fake_gpu import FakeGpu, card


@pytest.fixture
def fake(tmp_path, monkeypatch):
    """A library with a card that has passed its self-test."""
    made = FakeGpu(card())
    monkeypatch.setattr(library.LIBRARY, "loaded", made)
    monkeypatch.setattr(verdict, "cache_folder", lambda: tmp_path / "cache")
    monkeypatch.setattr(verdict, "_of_process", {})
    monkeypatch.setattr(choice, "_by_name", {})
    keep_verdict(find_devices().devices[0].key, DeviceVerdict(passed=True))
    yield made
    gpu_raster.close_all()


@pytest.mark.parametrize("verb", ["view", "eval", "compare"])
def test_the_device_draws_what_is_measured(gscore, fake, trained, tmp_path, verb) -> None:
    """Oracle: no draw of the card without the option, some with it; splats that stay are copied
    once for all pictures."""
    run, other = (shutil.copytree(trained, tmp_path / name) for name in ("run", "other"))
    words = {
        "view": (run, "-o", tmp_path / "page.html", "--photos", 0),
        "eval": (run,),
        "compare": (run, other, "-o", tmp_path / "compare.html"),
    }[verb]
    code, _, err = gscore(verb, *words)
    assert code == 0, err
    assert fake.calls == []
    code, _, err = gscore(verb, *words, "--device", "gpu")
    assert code == 0, err
    assert fake.calls.count("draw") >= 4
    assert fake.calls.count("upload") == (1 if verb == "eval" else 2)


def test_the_device_draws_for_a_refit(gscore, fake, trained, tmp_path) -> None:
    """Oracle: the card's name in the JSON, and what it draws: two pictures a step, one of them with
    gradients; one error where there is no card."""
    run = shutil.copytree(trained, tmp_path / "run")
    words = (run, "--for-viewer", "spark", "--iterations", 3, "--views", 0, "--json")
    code, out, err = gscore("refit", *words)
    assert code == 0 and json.loads(out)["device"] == "cpu", err
    code, out, err = gscore("refit", *words, "--device", "gpu")
    assert code == 0 and json.loads(out)["device"] == "Card", err
    assert (fake.calls.count("draw"), fake.calls.count("backward")) == (6, 3)
    code, _, err = gscore("refit", *words, "--device", "7")
    assert code == 2 and "There is no device 7" in err


def test_the_device_draws_levels_of_detail(gscore, fake, tmp_path) -> None:
    """Oracle: as above, for a model with two levels."""
    f, count = np.random.default_rng(3).normal, 9000
    shapes = {"means": (3,), "quats": (4,), "scales": (3,), "opacities": (), "sh0": (1, 3)}
    arrays = {name: f(size=(count, *shape)) for name, shape in shapes.items()}
    arrays |= {"scales": arrays["scales"] - 4, "shN": np.zeros((count, 0, 3))}
    splats = Splats(**{name: a.astype(np.float32) for name, a in arrays.items()})
    write_splats(tmp_path / "model.ply", splats)
    for device, least in (("cpu", 0), ("gpu", 12)):
        options = ("-o", tmp_path / f"{device}.lod", "--device", device)
        code, _, err = gscore("lod", tmp_path / "model.ply", *options)
        assert code == 0, err
        assert (fake.calls.count("draw") >= least) and bool(fake.calls) == bool(least)
