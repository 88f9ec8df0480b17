"""`gscore bench quality`; oracles: its own file, metrics of the pictures themselves, by hand."""

import json
import shlex
import statistics
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from gscore.bench import quality as study
from gscore.bench.paired import CaseChange, leave_out
from gscore.bench.quality import ScoredView, Training, compare, summarize
from gscore.bench.training import load_for_bench, train_measured
from gscore.commands import main
from gscore.commands.bench.quality_results import tables
from gscore.config import Switch, TrainConfig
from gscore.datasets import Dataset
from gscore.metrics import psnr
from gscore.presets import PRESETS
from gscore.trainer.schedule import caps
from tests.commands.small_bench import EXAMPLE, bench_json

TINY = ["-r", "100", "--mask-mode", "none", "--iterations", "6", "--preset", "preview"]


def _training(
    variant: str,
    psnr_cc: Sequence[float | None],
    *,
    capture: str = "plush",
    seed: int = 0,
    seconds: float = 10.0,
) -> Training:
    views = [
        ScoredView(name=f"{i}.jpg", psnr=db and db - 1, psnr_cc=db, ssim=0.9, lpips=None)
        for i, db in enumerate(psnr_cc)
    ]
    return Training(
        capture=capture,
        variant=variant,
        seed=seed,
        offset=3,
        seconds=seconds,
        splats=100,
        gap=2.0,
        views=tuple(views),
    )


def test_a_summary_is_not_moved_by_one_view() -> None:
    """Oracle: by hand; no number for an identical picture, and the worst view by name."""
    found = summarize(
        [_training("draft", [20, 21, 3, None]), _training("draft", [24, 23, 22, 25], seed=1)]
    )
    assert found.median["psnr_cc"] == 22 and found.trimmed["psnr_cc"] == 22
    assert found.median["psnr"] == 21 and found.median["lpips"] is None
    assert found.worst is not None
    assert (found.worst.view, found.worst.seed, found.worst.psnr_cc) == ("2.jpg", 0, 3)


def test_only_views_that_both_have_are_compared() -> None:
    """Oracle: by hand. Seed 1 was not trained with the change; one view is identical in one."""
    trainings = [
        _training("draft", [20, 21, None]),
        _training("draft", [0, 0, 0], seed=1),
        _training("soft", [20.2, 21.4, 30], seconds=9),
        _training("soft", [9], capture="horse"),
    ]
    found = compare(trainings, "draft", "soft")
    assert found is not None and list(found.captures) == ["plush"]
    assert found.psnr_cc.pairs == 2 and found.psnr_cc.median == pytest.approx(0.3)
    assert found.seconds == 0.9 and found.verdict.accepted
    assert compare(trainings, "draft", "hard") is None


def test_tables_by_hand() -> None:
    """Oracle: the lines written out."""
    trainings = [
        *(_training("draft", [20, 22, 24], capture=name) for name in ("plush", "horse")),
        _training("soft", [20.5, 22.5, 24.5], seconds=12),
        _training("soft", [20.5, 22.5, 24.5], seconds=10, capture="horse"),
    ]
    summaries = {"plush": {v: summarize([t for t in trainings if t.variant == v][:1])
                           for v in ("draft", "soft")}}  # fmt: skip
    found = compare(trainings, "draft", "soft")
    assert found is not None
    text = tables((summaries, [found]))
    assert text.splitlines() == [
        "| plush | PSNR | trimmed | colour-corrected | trimmed | SSIM | gap | splats | seconds | "
        "worst view, colour-corrected |",
        "|---|---|---|---|---|---|---|---|---|---|",
        "| draft | 21.00 | 21.00 | 22.00 | 22.00 | 0.9000 | 2.00 | 100 | 10.0 | "
        "20.00: 0.jpg, seed 0, offset 3 |",
        "| soft | 21.50 | 21.50 | 22.50 | 22.50 | 0.9000 | 2.00 | 100 | 12.0 | "
        "20.50: 0.jpg, seed 0, offset 3 |",
        "",
        "| against draft | capture | pairs | colour-corrected | 95 % | PSNR | SSIM | relative time "
        "|",
        "|---|---|---|---|---|---|---|---|",
        "| soft | plush | 3 | +0.50 | +0.50 to +0.50 | +0.50 | +0.0000 | 1.20 |",
        "| soft | horse | 3 | +0.50 | +0.50 to +0.50 | +0.50 | +0.0000 | 1.00 |",
        "| soft | all | 6 | +0.50 | +0.50 to +0.50 |  |  | 1.10 |",
        "",
        "soft: stays out (+0.50 dB, but 1.10 times as long).",
        "",
        "| means against draft | case | trainings | colour-corrected PSNR | SSIM | LPIPS | "
        "worst view | worst SSIM | relative time | relative splats |",
        "|---|---|---|---|---|---|---|---|---|---|",
        "| soft | plush | 1 | +0.50 | n/a | n/a | +0.50 | n/a | 1.20 | 1.00 |",
        "| soft | horse | 1 | +0.50 | n/a | n/a | +0.50 | n/a | 1.00 | 1.00 |",
        "",
        "soft: not kept (plush: SSIM was not measured).",
    ]


def _cased(
    variant: str, seed: int, *views: tuple[float | None, float, float, float], splats: int = 100
) -> Training:
    """A training of views with psnr_cc, ssim_cc, lpips_cc and coverage."""
    scored = tuple(
        ScoredView(
            name=f"{i}.jpg", psnr=db, psnr_cc=db, ssim=0.1, lpips=0.9, ssim_cc=ssim,
            lpips_cc=lpips, coverage=covered,
        )
        for i, (db, ssim, lpips, covered) in enumerate(views)
    )  # fmt: skip
    plain = _training(variant, [], seed=seed, seconds=10 + 5 * seed)
    return replace(plain, views=scored, splats=splats)


def test_means_and_the_worst_view_of_a_case() -> None:
    """Oracle: by hand. View 2 is covered by less than nine tenths in the mean of the base; the
    worst view is that with the lowest mean over seeds, another one after the change."""
    before = [
        _cased("draft", 0, (20, 0.8, 0.2, 1), (18, 0.6, 0.3, 1), (5, 0.1, 0.9, 0.95)),
        _cased("draft", 1, (22, 0.9, 0.1, 1), (20, 0.6, 0.3, 1), (5, 0.1, 0.9, 0.8)),
    ]
    after = [
        _cased("soft", 0, (18, 0.7, 0.2, 1), (22, 0.9, 0.3, 1), (9, 0.1, 0.9, 1), splats=50),
        _cased("soft", 1, (19, 0.7, 0.2, 1), (None, 0.9, 0.3, 1), (9, 0.1, 0.9, 1), splats=30),
    ]
    found = compare([*before, *after], "draft", "soft")
    assert found is not None
    case = found.cases["plush"]
    assert case.trainings == 2
    # Seed 0: -2, 4, 4; seed 1: -3 and 4, as view 1 has none.
    assert case.psnr_cc == pytest.approx((6 / 3 + 1 / 2) / 2)
    assert case.ssim_cc == pytest.approx(((-0.1 + 0.3) / 3 + (-0.2 + 0.3) / 3) / 2)
    assert case.lpips_cc == pytest.approx((0 + 0.1 / 3) / 2)
    assert case.worst_psnr_cc == pytest.approx(18.5 - 19)  # view 0 after, view 1 before
    assert case.worst_ssim_cc == pytest.approx(0.7 - 0.6)
    assert case.splats == pytest.approx(0.4) and case.seconds == 1
    assert not found.leave_out.kept and "two captures" in found.leave_out.why
    summary = summarize(before)
    assert summary.worst_view == {
        "psnr_cc": {"view": "1.jpg", "value": 19},
        "ssim_cc": {"view": "1.jpg", "value": pytest.approx(0.6)},
    }
    assert summary.not_covered == ["2.jpg"]


def _change(psnr_cc: float, **others: float | None) -> CaseChange:
    values = {"ssim_cc": 0.0, "lpips_cc": 0.0, "worst_psnr_cc": 0.0, "worst_ssim_cc": 0.0}
    values |= {"seconds": 1.0, "splats": 1.0} | others
    return CaseChange(trainings=1, psnr_cc=psnr_cc, **values)  # pyright: ignore


def test_a_change_must_hold_without_each_capture() -> None:
    """Oracle: by hand. The gain of both cases of one capture does not count for it."""
    cases = {"a": 0.4, "a, 1 photo in 3": 0.6, "b": 0.1, "c": -0.05}
    found = leave_out({name: _change(gain) for name, gain in cases.items()})
    assert found.gains == pytest.approx({"a": 0.025, "b": 0.4, "c": 0.4})
    assert found.kept and found.why == "+0.25 dB in the median, +0.03 without a"
    cases["b"] = 0.05
    found = leave_out({name: _change(gain) for name, gain in cases.items()})
    assert not found.kept and found.why.endswith("+0.00 without a")
    assert not leave_out({"a": _change(9), "a, 1 photo in 2": _change(9)}).kept


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_change(-0.15), ""),
        (_change(-0.16), "b: loses 0.16 dB"),
        (_change(0, ssim_cc=-0.002), ""),
        (_change(0, ssim_cc=-0.0021), "b: loses 0.0021 SSIM"),
        (_change(0, lpips_cc=0.003), ""),
        (_change(0, lpips_cc=0.0031), "b: loses 0.0031 LPIPS"),
        (_change(0, worst_psnr_cc=-1.0), ""),
        (_change(0, worst_psnr_cc=-1.01), "b: its worst view loses 1.01 dB"),
        (_change(0, lpips_cc=None), ""),
        (_change(0, ssim_cc=None), "b: SSIM was not measured"),
        (_change(0, worst_psnr_cc=None), "b: a worst view was not measured"),
    ],
)
def test_no_capture_may_lose_more_than_the_limits(change: CaseChange, words: str) -> None:
    """Oracle: the limits: 0.15 dB, .002 SSIM, .003 LPIPS, 1 dB of the worst view."""
    found = leave_out({"a": _change(1), "b": change, "c": _change(1)})
    assert found.kept is (not words) and words in found.why


def test_photos_are_thinned_and_results_continue(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: every third training photo, the same held-out views; the stored command, which finds
    all trainings done and prints the tables of results.md."""
    seen: dict[str, tuple[list[int], list[int]]] = {}
    real = study.train_scored

    def noted(config: TrainConfig, photos: Dataset, eval_views: Dataset, **names: object):
        seen[str(names["capture"])] = photos.train, photos.test
        assert eval_views.train == photos.train
        return real(config, photos, eval_views, **names)  # pyright: ignore

    monkeypatch.setattr("gscore.commands.bench.quality.train_scored", noted)
    out = tmp_path / "out"
    command = ["quality", str(EXAMPLE), *TINY, "-o", str(out), "--seeds", "0", "--offsets", "0"]
    command += ["--thin", "1", "3", "1", "--test-every", "20"]
    found = bench_json(capsys, *command)
    assert list(seen) == ["studio", "studio, 1 photo in 3"] == list(found["captures"])
    (all_photos, held_out), (few, same) = seen.values()
    assert few == all_photos[::3] and held_out == same
    assert all(0 <= v["coverage"] <= 1 for t in found["trainings"] for v in t["views"])
    monkeypatch.setattr("gscore.commands.bench.quality.train_scored", None)
    assert main(shlex.split(found["command"])[1:]) == 0  # with other options it would be refused
    tables = capsys.readouterr().out
    page = (out / "results.md").read_text()
    assert page.endswith(f"\n```\n{found['command']}\n```\n\n{tables}")


def test_exposure_is_that_of_the_photo_at_any_size() -> None:
    """Oracle: the same training measured on photos of the same size that it does not own."""
    data, config = PRESETS["preview"](EXAMPLE)
    data = replace(data, mask_mode="none", test_every=20, test_offset=2, eval=True, resolution=60)
    config = replace(config, iterations=40, exposure=Switch.ON, exposure_lr=0.1)
    photos, others = load_for_bench(data), load_for_bench(data)
    named = {"capture": "studio", "variant": "v", "offset": 2}
    own, apart = (study.train_scored(config, photos, one, **named) for one in (photos, others))
    plain = study.train_scored(replace(config, exposure=Switch.OFF), photos, photos, **named)
    for one, other, without in zip(own.views, apart.views, plain.views, strict=True):
        assert one.psnr == pytest.approx(other.psnr, abs=1e-3)
        assert one.psnr != pytest.approx(without.psnr, abs=1e-2)


def test_a_study_is_trained_once_and_goes_on(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the requested trainings, in turns; after a stop only the missing ones, and the
    figures of an uninterrupted study."""
    out, done, trained = tmp_path / "out", [], {}
    real = study.train_scored

    def counted(config: TrainConfig, *args: Dataset, **names: object) -> Training:
        if len(done) == stop_at:
            raise KeyboardInterrupt
        done.append((names["variant"], config.seed, names["offset"]))
        key = names["variant"], names["offset"]
        if key not in trained:  # one training measures for all seeds
            trained[key] = real(config, *args, **names)  # pyright: ignore
        return replace(trained[key], seed=config.seed)

    monkeypatch.setattr("gscore.commands.bench.quality.train_scored", counted)
    command = ["quality", str(EXAMPLE), *TINY, "-o", str(out), "--seeds", "0", "1"]
    command += ["--offsets", "0", "3", "--test-every", "20", "--compare", "dark=sh0-lr=0"]
    stop_at = 3
    assert main(["bench", *command]) != 0
    stopped = json.loads((out / "results.json").read_text())
    assert not stopped["finished"] and len(stopped["trainings"]) == 3
    assert stopped["comparisons"][0]["psnr_cc"]["pairs"] == len(stopped["trainings"][0]["views"])
    capsys.readouterr()
    stop_at = -1
    found = bench_json(capsys, *command)
    assert found == json.loads((out / "results.json").read_text()) and found["finished"]
    order = [(v, s, o) for o in (0, 3) for s in (0, 1) for v in ("preview", "dark")]
    assert done == order
    assert found["trainings"][:3] == stopped["trainings"]
    views = {o: {v["name"] for t in found["trainings"] if t["offset"] == o for v in t["views"]}
             for o in (0, 3)}  # fmt: skip
    assert views[0] and views[3] and not views[0] & views[3]
    assert main(["bench", *command]) == 0 and len(done) == len(order)
    assert "dark: stays out (studio loses" in capsys.readouterr().out
    assert main(["bench", *command, "--iterations", "7"]) == 2
    message = capsys.readouterr().err
    assert "iterations was 6, is 7" in message and str(out / "results.json") in message


def test_trainings_take_the_steps_that_gscore_train_takes(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: 3 steps for each training photo, where that exceeds the minimum; all steps without
    the limit."""
    monkeypatch.setattr(caps, "_FEWEST_STEPS", 10)
    monkeypatch.setattr(caps, "_FEWEST_SPLATS", 10)
    taken, splats, done = {}, {}, []
    real = study.train_scored

    def noted(config: TrainConfig, photos: Dataset, *args: Dataset, **names: object) -> Training:
        taken[names["variant"]] = config.iterations
        splats[names["variant"]] = config.max_splats
        assert taken.setdefault("photos", len(photos.train)) == len(photos.train)
        if not done:  # one training measures for all variants
            done.append(real(replace(config, iterations=2), photos, *args, **names))  # pyright: ignore
        return replace(done[0], variant=str(names["variant"]))

    monkeypatch.setattr("gscore.commands.bench.quality.train_scored", noted)
    command = ["quality", str(EXAMPLE), "-r", "60", "--mask-mode", "none", "--preset", "normal"]
    command += ["--seeds", "0", "--offsets", "0", "-o", str(tmp_path / "out"), "--compare"]
    command += ["few=steps-a-photo=3", "all=steps-a-photo=0"]
    # Two models, unless the photos agree.
    command += ["thin=splats-a-photo=300", "one=splats-a-photo=300,ensemble=1"]
    bench_json(capsys, *command)
    assert (taken["few"], taken["all"]) == (3 * taken["photos"], 7000)
    assert taken["normal"] == min(80 * taken["photos"], 7000) < 7000
    assert splats["normal"] == 300_000
    assert (splats["thin"], splats["one"]) == (600 * taken["photos"], 300 * taken["photos"])


def test_a_training_is_measured_like_an_evaluation() -> None:
    """Oracle: other figures of the same views at twice the size; LPIPS only with a network; the gap
    of the medians."""
    data, config = PRESETS["preview"](EXAMPLE)
    data = replace(data, mask_mode="none", test_every=20, test_offset=2, eval=True, resolution=60)
    config = replace(config, iterations=3, seed=4)
    small, large = load_for_bench(data), load_for_bench(replace(data, resolution=120))
    named = {"capture": "studio", "variant": "v", "offset": 2}
    own, wide = (
        study.train_scored(config, small, evaluated, **named) for evaluated in (small, large)
    )
    assert own.key == ("studio", "v", 4, 2) and own.splats == wide.splats
    assert [view.name for view in own.views] == [small.names[i] for i in small.test]
    assert all(view.lpips is None and view.ssim for view in own.views)
    assert own.views[0].psnr != wide.views[0].psnr
    held_out = statistics.median(view.psnr or 0 for view in own.views)
    trained: list[float] = []
    train_measured(
        config,
        small,
        at_end=lambda draw, _: trained.extend(psnr(draw(i), small.image(i)) for i in small.train),
    )
    assert own.gap == pytest.approx(statistics.median(trained) - held_out)
    assert study.read_training(json.loads(json.dumps(study.training_json(own)))) == own


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--offsets", "8"], "test_offset must be 0 to 7, less than test_every, got 8"),
        (["--offsets", "-1"], "--offsets must be at least 0, got -1"),
        (["--seeds", "-1"], "--seeds must be at least 0, got -1"),
        (["--test-last", "2"], "selects test views by --offsets"),
        (["--compare", "mcmc"], "--compare takes NAME=CHANGES"),
        (["--compare", "draft=mcmc"], "two variants are called 'draft'"),
        (["--compare", "a=speed=1"], "--compare speed=1: there is no option 'speed'"),
        (["--compare", "a=prune_share=0"], "--compare a changes nothing: it is the same as draft"),
        (["--compare", "a=mcmc", "b=mcmc"], "--compare b changes nothing: it is the same as a"),
        (["--compare", "a=preset=fast"], "--compare a: there is no preset 'fast'"),
        ([str(EXAMPLE)], "Two captures are called 'studio'"),
        (["--lpips", "none.onnx"], "none.onnx"),
    ],
)
def test_everything_is_checked_before_training(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    options: list[str],
    words: str,
) -> None:
    """Oracle: the message; a training would fail the test."""
    monkeypatch.setattr("gscore.commands.bench.quality.train_scored", None)
    out = ["-o", str(tmp_path / "out")]
    assert main(["bench", "quality", str(EXAMPLE), *options, *out]) == 2
    message = capsys.readouterr().err
    assert words in " ".join(message.split()) and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "content", ['{"gscore": 1}', '["gscore"]', '{"gscore"', '{"gscore": 1, "setting": {}, '
    '"trainings": [{"views": [{"name": []}]}]}']
)  # fmt: skip
def test_damaged_results_are_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str
) -> None:
    """Oracle: the message, which names the file; the file is unchanged."""
    path = tmp_path / "results.json"
    path.write_text(content)
    assert main(["bench", "quality", str(EXAMPLE), *TINY, "-o", str(tmp_path)]) == 2
    assert str(path) in capsys.readouterr().err and path.read_text() == content
