"""Sentences on the figures of metrics.json."""

from gscore.text_format import colour_text, verdict_text, views_text


def test_a_sample_of_the_training_views_is_called_one() -> None:
    """Oracle: 8 of 59 training views were measured, then all, then held-out ones."""
    views, train = [{}] * 8, ["a"] * 59
    sample = {"split": "train", "views": views, "train_views": train}
    assert views_text(sample) == "8 training views, a sample of 59"
    assert views_text(sample | {"train_views": train[:8]}) == "8 training views"
    assert views_text(sample | {"split": "test"}) == "8 test views"
    assert views_text(sample | {"split": "all", "views": views[:1]}) == "1 view"


def test_low_figures_of_whole_trainings_have_a_verdict() -> None:
    """Oracle: the limit of 20 dB, of pixels inside masks if there are any."""
    assert "Below 20 dB" in verdict_text({"psnr": 16.9, "reason": "finished"})
    assert "Below 20 dB" in verdict_text({"psnr": 25.0, "psnr_masked": 16.9})
    assert verdict_text({"psnr": 20.1}) == verdict_text({"psnr": None}) == ""
    assert verdict_text({"psnr": 16.9, "reason": "stopped", "steps": 20}) == ""


def test_a_colour_correction_that_lowers_psnr_is_explained() -> None:
    """Oracle: both figures."""
    assert colour_text({"psnr": 24.0, "psnr_cc": 24.5}) == "; colour-corrected PSNR 24.50 dB"
    assert colour_text({"psnr": 24.0, "psnr_cc": 23.95}) == "; colour-corrected PSNR 23.95 dB"
    assert "PSNR 23.90 dB (lower: halves" in colour_text({"psnr": 24.0, "psnr_cc": 23.9})
