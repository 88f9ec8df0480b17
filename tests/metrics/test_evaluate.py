"""Scores of a dataset's views: means, masks, reasons, timing and metrics.json."""

import json
import math
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from gscore.errors import ShapeError
from gscore.events import headline_psnr
from gscore.metrics import evaluate, headline, psnr, write_metrics
from gscore.metrics.evaluate import target_picture
from gscore.text_format import quality_text


class FakeLpips:
    """Replacement for a network: the mean absolute difference."""

    key, net = "lpips_fake", "fake"

    def __call__(self, image, target):
        return float(np.abs(image - target).mean())


def photos(count, size=(40, 50)):
    rng = np.random.default_rng(5)
    return [rng.integers(0, 256, (*size, 3), dtype=np.uint8) for _ in range(count)]


def test_views_and_their_mean(fake_dataset):
    """Oracle: the single metrics on the same pictures."""
    pictures = photos(3)
    renders = [np.clip(p / 255 + 0.02 * (i + 1), 0, 1) for i, p in enumerate(pictures)]
    result = evaluate(lambda i: renders[i], fake_dataset(pictures), [2, 0], lpips=FakeLpips())
    assert [v["name"] for v in result.views] == ["view_2.png", "view_0.png"]
    want = [psnr(renders[i], pictures[i]) for i in (2, 0)]
    assert [v["psnr"] for v in result.views] == want
    mean = result.mean
    assert mean["psnr"] == pytest.approx(sum(want) / 2)
    assert mean["lpips"] == mean["lpips_fake"] > 0
    assert mean["lpips_net"] == "fake" and "lpips_reason" not in mean
    assert mean["ms_ssim"] is None and "161" in mean["ms_ssim_reason"]
    assert "psnr_masked" not in mean


def test_without_lpips_the_reason_is_kept(fake_dataset):
    """Oracle: null and the sentence of find_lpips."""
    result = evaluate(
        lambda i: np.zeros((40, 50, 3)), fake_dataset(photos(1)), [0], lpips_reason="no file"
    )
    for key in ("lpips", "lpips_cc"):
        assert result.mean[key] is None and result.mean[f"{key}_reason"] == "no file"
    assert result.mean["lpips_net"] is None


def test_composite_lays_the_photo_over_the_background():
    """Oracle: a straight-alpha blend written out for one pixel."""
    photo = np.full((1, 1, 3), (200, 100, 50), np.uint8)
    mask = np.full((1, 1), 51, np.uint8)  # a fifth
    target, weights = target_picture(photo, mask, "composite", (1.0, 0.0, 0.5))
    want = np.array([200, 100, 50]) / 255 * 0.2 + np.array([1.0, 0.0, 0.5]) * 0.8
    np.testing.assert_allclose(target[0, 0], want, atol=1e-12)
    assert weights is None


def test_ignored_pixels_do_not_count(fake_dataset):
    """Oracle: a render that is wrong only where the mask is 0."""
    pictures = photos(2)
    mask = np.full((40, 50), 255, np.uint8)
    mask[:10] = 0
    renders = [p / 255 for p in pictures]
    renders[0] = renders[0].copy()
    renders[0][:10] = 0.5
    renders[0][10:] = np.clip(renders[0][10:] * 0.9, 0, 1)
    renders[1] = renders[1] * 0.9
    dataset = fake_dataset(pictures, [mask, None], "ignore")
    result = evaluate(lambda i: renders[i], dataset, [0, 1], lpips=FakeLpips())
    first, second = result.views
    assert first["psnr_masked"] == pytest.approx(psnr(renders[0][10:], pictures[0][10:]))
    assert first["psnr"] > first["psnr_masked"]
    assert psnr(renders[0], pictures[0], mask=mask) == pytest.approx(first["psnr_masked"])
    assert math.isnan(psnr(renders[0], pictures[0], mask=np.zeros_like(mask)))
    assert headline_psnr(result.mean) == result.mean["psnr_masked"]
    words = f"PSNR inside the masks {result.mean['psnr_masked']:.2f} dB ("
    assert words in quality_text(result.mean)
    assert second["psnr_masked"] == pytest.approx(second["psnr"])
    kept = np.abs(renders[0][10:] - pictures[0][10:] / 255).sum()
    assert first["lpips"] == pytest.approx(kept / (40 * 50 * 3))
    ignoring_nothing = evaluate(lambda i: renders[i], fake_dataset(pictures, [mask, None]), [0])
    assert ignoring_nothing.mean["psnr"] < first["psnr_masked"]
    assert headline_psnr(ignoring_nothing.mean) == ignoring_nothing.mean["psnr"]
    assert "masks" not in quality_text(ignoring_nothing.mean)
    dataset.evaluated_part = "region"
    of_region = evaluate(lambda i: renders[i], dataset, [0, 1])
    for numbers in (of_region.mean, *of_region.views):
        assert quality_text(numbers).startswith("PSNR inside the region ")


def test_only_rendering_is_timed_and_warm(fake_dataset, monkeypatch):
    """Oracle: a clock that a render moves by 20 ms, the first by 200 ms, a photo by a second."""
    calls, clock, dataset = [], [0.0], fake_dataset(photos(3))
    module = sys.modules["gscore.metrics.evaluate"]  # the package's attribute is the function
    monkeypatch.setattr(module, "time", SimpleNamespace(perf_counter=lambda: clock[0]))
    real = dataset.image

    def render(index):
        calls.append(index)
        clock[0] += 0.2 if len(calls) == 1 else 0.02
        return np.zeros((40, 50, 3))

    def image(index):
        clock[0] += 1.0
        return real(index)

    monkeypatch.setattr(dataset, "image", image)
    result = evaluate(render, dataset, range(3))
    assert calls == [0, 0, 1, 2]
    assert result.mean["fps"] == pytest.approx(50)


def test_a_broken_render_names_the_view(fake_dataset):
    """Oracle: the error's text."""
    with pytest.raises(ShapeError, match=r"View view_0\.png .* same size"):
        evaluate(lambda i: np.zeros((40, 51, 3)), fake_dataset(photos(1)), [0])
    with pytest.raises(ShapeError, match=r"View view_0\.png .* not finite"):
        evaluate(lambda i: np.full((40, 50, 3), np.inf), fake_dataset(photos(1)), [0])


def test_no_views_give_nulls(fake_dataset):
    """Oracle: null for every metric, with a reason."""
    mean = evaluate(lambda i: None, fake_dataset([]), []).mean
    assert mean["psnr"] is None and mean["psnr_reason"] == "no view to score"
    assert mean["fps"] is None


def test_identical_pictures_become_null_not_infinity(fake_dataset, tmp_path):
    """Oracle: strict JSON, which has no infinity."""
    pictures = photos(1)
    result = evaluate(lambda i: pictures[i] / 255.0, fake_dataset(pictures), [0])
    assert result.mean["psnr"] is None and "view_0.png" in result.mean["psnr_reason"]
    write_metrics(tmp_path / "m.json", vars(result))


def test_metrics_json(metrics_dict, tmp_path):
    """Oracle: the keys that programs read, and a file replaced as a whole."""
    metrics, _ = metrics_dict()
    path = tmp_path / "metrics.json"
    path.write_text("old")
    write_metrics(path, metrics)
    read = json.loads(path.read_text())
    for key in ("psnr", "ssim", "splats", "train_seconds", "peak_memory_bytes", "fps"):
        assert isinstance(read[key], int | float), key
    assert read["lpips"] is None and read["lpips_reason"]
    assert read["machine"]["isa"] == "scalar" and read["machine"]["cores"] >= 1
    assert read["views"][0]["name"] == "view_0.png"
    assert [p.name for p in tmp_path.iterdir()] == ["metrics.json"]
    short = headline(read)
    assert "views" not in short and "test_views" not in short and short["psnr"] == read["psnr"]
