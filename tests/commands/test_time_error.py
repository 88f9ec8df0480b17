"""`gscore bench time-error`; oracle: the promised keys, and arithmetic between them."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import gscore
from gscore.bench.synthetic import SyntheticPhotos, synthetic_scene
from gscore.bench.time_error import (
    Curve,
    Size,
    SizeOutcome,
    curve_json,
    labels,
    measure_variant,
    measured_steps,
    pareto_front,
    read_peers,
    time_to_psnr,
)
from gscore.bench.training import (
    Point,
    Trained,
    Variant,
    load_for_bench,
    open_variants,
    train_measured,
)
from gscore.commands import main
from gscore.commands.bench.time_error import table, write_curves
from gscore.config import DataConfig, Skip, Strategy, TrainConfig
from gscore.datasets import Dataset
from gscore.presets import PRESETS
from gscore.trainer.trainer import Trainer
from tests.commands.small_bench import EXAMPLE, bench_json


def test_time_error_writes_curves_and_figures(
    capsys: pytest.CaptureFixture[str], small: list[str], tmp_path: Path
) -> None:
    """Oracle: its own file, read back as the curves of a peer."""
    out = tmp_path / "out"
    options = [str(EXAMPLE), *small, "--seeds", "0", "1", "-o", str(out)]
    found = bench_json(capsys, "time-error", *options, "--ablations", "small-photos")
    assert found == json.loads((out / "results.json").read_text())
    curves = found["captures"]["studio"]["curves"]
    assert [c["label"] for c in curves] == ["preview", "preview without small-photos"]
    for curve in curves:
        assert len(curve["seeds"]) == 2
        steps = [point["step"] for point in curve["seeds"][0]]
        assert steps == measured_steps(12)
        seconds = [point["seconds"] for point in curve["seeds"][0]]
        assert seconds == sorted(seconds) and seconds[0] > 0
    for name in ("psnr", "1-ssim", "splats"):
        assert (out / f"studio-{name}.svg").read_text().startswith("<svg")
    peer = tmp_path / "peer.json"
    peer.write_text(json.dumps({"capture": "studio", "curves": curves[:1]}))
    again = bench_json(capsys, "time-error", *options, "--peers", str(peer))
    untold = dict.fromkeys(("trained_width", "iterations", "max_splats"))
    assert again["captures"]["studio"]["curves"][1] == curves[0] | untold
    assert again["finished"]


def test_ablations_change_what_they_name(
    small: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the configs of the trainings."""
    trained: list[TrainConfig] = []

    def measured(variant: Variant, *_: object, **__: object) -> Curve:
        trained.append(variant.config)
        return Curve(label=variant.label, width=9, height=9, seeds=[[_point(1, 20)]])

    monkeypatch.setattr("gscore.commands.bench.time_error.measure_variant", measured)
    ablations = [
        "mcmc",
        "mcmc,small-photos,rare-sh",
        "free-space=0,prune_share=0.25",
        "antialias=on",
    ]
    command = ["bench", "time-error", str(EXAMPLE), *small, "--ablations", *ablations]
    assert main([*command, "-o", str(tmp_path / "out")]) == 0
    plain = trained[0]
    skips = (Skip.SMALL_PHOTOS, Skip.RARE_SH)
    assert trained[1:] == [
        replace(plain, strategy=Strategy.MCMC),
        replace(plain, strategy=Strategy.MCMC, without=skips),
        replace(plain, free_space=0.0, prune_share=0.25),
        replace(plain, antialias=True),
    ]
    found = json.loads((tmp_path / "out" / "results.json").read_text())
    assert [curve["label"] for curve in found["captures"]["studio"]["curves"]] == [
        "preview",
        "preview mcmc",
        "preview mcmc, without small-photos, without rare-sh",
        "preview free-space=0, prune_share=0.25",
        "preview antialias=on",
    ]


@pytest.mark.slow
def test_all_sizes_are_measured_at_one_size(
    capsys: pytest.CaptureFixture[str], small: list[str], tmp_path: Path
) -> None:
    """Oracle: the preset's own size as the last point of its curve; fronts by hand."""
    out = tmp_path / "out"
    options = [str(EXAMPLE), *small[2:], "--seeds", "0", "-o", str(out)]
    sizes = ["--sweep-splats", "2000", "50000", "--sweep-widths", "120", "400"]
    capture = bench_json(capsys, "time-error", *options, *sizes)["captures"]["studio"]
    end = capture["curves"][0]["seeds"][0][-1]
    rows = {
        (row["size"]["max_splats"], row["size"]["width"]): row
        for row in capture["sizes"]["outcomes"]
    }
    assert list(rows) == [(2000, 120), (50000, 120), (2000, 400), (50000, 400)]
    assert capture["sizes"]["judged_on"] == [400, 533]
    own = rows[50_000, 400]
    assert (own["psnr"], own["ssim"], own["splats"]) == (end["psnr"], end["ssim"], end["splats"])
    # Small photos are evaluated at the large size too, by pictures of the same splats.
    assert rows[50_000, 120]["psnr"] != own["psnr"]
    fastest = min(rows.values(), key=lambda row: row["seconds"])
    assert fastest["best_for_its_time"]
    assert (out / "studio-sizes.svg").read_text().startswith("<svg")
    assert main(["bench", "time-error", *options, "-r", "200", "--sweep-splats", "9"]) == 2
    assert "--sweep-widths" in capsys.readouterr().err


def test_photos_of_another_size_measure_the_same_splats() -> None:
    """Oracle: the same figures of a training evaluated on a second copy of its own photos."""
    data, config = PRESETS["preview"](EXAMPLE)
    data = replace(data, mask_mode="none", test_every=20, eval=True, resolution=120)
    config = replace(config, iterations=3)
    own, again = (
        train_measured(config, load_for_bench(data), eval_views=evaluated).points[-1]
        for evaluated in (None, load_for_bench(data))
    )
    assert again.psnr == pytest.approx(own.psnr, abs=2e-3)
    assert again.ssim == pytest.approx(own.ssim, abs=2e-4)


def test_fronts() -> None:
    """Oracle: by hand. c costs more than b and is worse; d costs as much as a and is worse."""

    def outcome(seconds: float, psnr: float) -> SizeOutcome:
        size = Size(preset="p", max_splats=1, width=1, iterations=1)
        return SizeOutcome(size=size, seconds=seconds, splats=1, psnr=psnr, ssim=0.5, seeds=[psnr])

    a, b, c, d = (outcome(*pair) for pair in ((1, 20), (2, 25), (3, 24), (1, 19)))
    unknown = outcome(0.5, float("nan"))
    assert pareto_front([c, d, unknown, b, a], lambda o: o.seconds) == [a, b]
    assert pareto_front([c, d, b, a], lambda o: o.splats) == [b]


def test_bad_peers_are_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Oracle: the message, which names the file and the missing key."""
    peer = tmp_path / "peer.json"
    options = ["bench", "time-error", str(EXAMPLE), "-o", str(tmp_path / "o"), "--peers", str(peer)]
    for content, word in (("{", "not a file of curves"), ('{"capture": "a"}', "'curves'")):
        peer.write_text(content)
        assert main(options) == 2
        message = capsys.readouterr().err
        assert str(peer) in message and word in message


def test_time_to_psnr_is_read_off_the_median() -> None:
    """Oracle: by hand. The slow curve passes 27 dB halfway between its points."""

    def curve(label: str, *points: tuple[float, float]) -> Curve:
        made = [Point(step=1, seconds=s, splats=1, psnr=p, ssim=0.9) for s, p in points]
        return Curve(label=label, width=1, height=1, seeds=[made])

    rows = time_to_psnr([curve("a", (1, 20), (2, 28)), curve("b", (10, 26.5), (20, 27.5))])
    assert [row["label"] for row in rows] == ["a", "b"]
    assert rows[0]["seconds"] == {"27.00": pytest.approx(1.875), "27.50": 1.9375, "28.00": 2.0}
    assert rows[1]["seconds"] == {"27.00": pytest.approx(15), "27.50": 20, "28.00": None}


def _point(seconds: float, psnr: float, *, splats: int = 1, ssim: float = 0.9) -> Point:
    return Point(step=1, seconds=seconds, splats=splats, psnr=psnr, ssim=ssim)


def test_evaluation_and_callbacks_are_outside_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: a clock that a step moves by 2 s, a measurement and a callback by 1000 s."""
    now = [0.0]
    monkeypatch.setattr("gscore.bench.training.time", SimpleNamespace(perf_counter=lambda: now[0]))
    advance = Trainer.advance

    def slow_step(trainer: Trainer) -> None:
        advance(trainer)
        now[0] += 2

    def slow_quality(*_: object) -> tuple[float, float]:
        now[0] += 1000
        return 20.0, 0.5

    def slow_callback(_: int) -> None:
        now[0] += 1000

    monkeypatch.setattr(Trainer, "advance", slow_step)
    monkeypatch.setattr("gscore.bench.training.quality", slow_quality)
    data, config = PRESETS["preview"](EXAMPLE)
    photos = load_for_bench(
        replace(data, mask_mode="none", test_every=20, eval=True, resolution=60)
    )
    config = replace(config, iterations=4, threads=1)
    found = train_measured(config, photos, at=(1, 3), on_step=slow_callback)
    assert [(p.step, p.seconds) for p in found.points] == [(1, 2), (3, 6), (4, 8)]
    assert found.seconds == 8


def test_curves_and_sizes_are_medians(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the middle one of three seeds, which is neither first nor largest."""
    seeds = [
        [_point(s, p, splats=n, ssim=q)]
        for s, p, n, q in ((3, 10, 30, 0.1), (2, 30, 10, 0.9), (1, 20, 20, 0.5))
    ]
    median = Curve(label="a", width=1, height=1, seeds=seeds).median()
    assert median == [_point(2, 20, splats=20, ssim=0.5)]

    def trained(config: TrainConfig, *_: object, **__: object) -> Trained:
        points = seeds[config.seed]
        splats = synthetic_scene(1)[0]
        return Trained(
            seconds=points[0].seconds,
            points=points,
            forward_pairs=1,
            backward_pairs=1,
            splats=splats,
            near=0.01,
        )

    monkeypatch.setattr("gscore.bench.time_error.train_measured", trained)
    size = Size(preset="p", max_splats=1, width=1, iterations=1)
    photos: Any = SyntheticPhotos(1, 16, 16)
    variant = Variant(
        label="p",
        data=DataConfig(source=EXAMPLE),
        config=TrainConfig(),
        photos=photos,
        eval_views=photos,
    )
    found = SizeOutcome.of(size, measure_variant(variant, [0, 1, 2], along=False))
    assert (found.seconds, found.psnr, found.splats, found.ssim) == (2, 20, 20, 0.5)
    assert found.seeds == [10, 30, 20]


def _peer(path: Path, capture: str = "studio", **changed: object) -> Path:
    points = [{"seconds": 1.0, "psnr": 20.0}, {"seconds": 2.0, "psnr": 25.0}]
    curve = {"label": "other", "width": 400, "height": 533, "seeds": [points, points]} | changed
    path.write_text(json.dumps({"capture": capture, "curves": [curve]}))
    return path


def test_missing_peer_values_are_null(tmp_path: Path) -> None:
    """Oracle: strict JSON with null, read back unchanged; a figure without that curve."""
    capture, (curve,) = read_peers(_peer(tmp_path / "peer.json"))
    content = curve_json(curve)
    text = json.dumps(content, allow_nan=False)
    assert content["seeds"][0][0]["ssim"] is None and content["seeds"][0][0]["splats"] is None
    again = tmp_path / "again.json"
    again.write_text(json.dumps({"capture": capture, "curves": [json.loads(text)]}))
    assert curve_json(read_peers(again)[1][0]) == content
    write_curves(tmp_path, "studio", [curve])
    assert [p.name for p in sorted(tmp_path.glob("*.svg"))] == ["studio-psnr.svg"]


POINT = {"seconds": 1.0, "psnr": 20.0}


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"seeds": []}, "seeds must be a list of at least one entry"),
        ({"seeds": [[]]}, "at least one, got [0]"),
        (
            {"seeds": [[POINT], [POINT, POINT]]},
            "the same number of points, at least one, got [1, 2]",
        ),
        ({"seeds": [[POINT | {"psnr": float("nan")}]]}, "seed 0, point 0: psnr must be"),
        ({"seeds": [[POINT | {"seconds": -1}]]}, "seconds must be a number from 0"),
        ({"seeds": [[POINT | {"psnr": 10**400}]]}, "psnr must be a number from 0"),
        ({"seeds": [[POINT | {"ssim": 2}]]}, "ssim must be a number from -1 to 1, got 2"),
        ({"seeds": [[POINT | {"seconds": 2}, POINT]]}, "points must be sorted by seconds"),
        ({"seeds": [[POINT | {"splats": 1.5}]]}, "splats must be a whole number"),
        ({"seeds": [[[]]]}, "not a file of curves"),
        ({"width": 0}, "width must be a number from 1"),
    ],
)
def test_curves_that_cannot_be_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changed: dict, words: str
) -> None:
    """Oracle: the message, which names the file, the place and the expected value."""
    peer = _peer(tmp_path / "peer.json", **changed)
    options = ["-o", str(tmp_path / "out"), "--peers", str(peer)]
    assert main(["bench", "time-error", str(EXAMPLE), *options]) == 2
    message = capsys.readouterr().err
    assert str(peer) in message and words in message and len(message.splitlines()) == 1


def test_only_curves_of_one_size_are_compared() -> None:
    """Oracle: by hand. The peer at 800 px is better, and no target for those at 400 px."""
    a, b = (
        Curve(label=label, width=400, height=300, seeds=[[_point(1, 20), _point(2, end)]])
        for label, end in (("a", 25), ("b", 24))
    )
    peer = Curve(label="peer", width=800, height=600, seeds=[[_point(9, 30)]])
    rows = time_to_psnr([a, b, peer])
    assert [max(row["seconds"], key=float) for row in rows] == ["25.00", "25.00", "30.00"]
    assert labels([a, b]) == ["a", "b"]
    assert labels([a, peer]) == ["a, 400 px", "peer, 800 px"]
    assert table("c", [a, b]).count("final PSNR") == 1
    assert "| c, 400 px | final PSNR | s to 24.00 dB" in table("c", [a, b, peer])
    assert "| c, 800 px | final PSNR | s to 29.00 dB" in table("c", [a, b, peer])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["nowhere"], "nowhere"),
        ([str(EXAMPLE)], "Two captures are called 'studio'"),
        (["--seeds", "0", "-1"], "seed must be 0 to 9223372036854775807, got -1"),
        (["--peers", "PEER"], "curves of the capture 'horse', which is not measured here; "),
        (["--sweep-splats", "9", "0"], "at least 1"),
        (["--ablations", "mcmc", "speed"], "There is no change 'speed'"),
        (["--ablations", "mcmc,speed=1"], "--ablations speed=1: there is no option 'speed'"),
        (["--ablations", "free-space=2"], "free_space must be 0 to less than 1, got 2"),
        (["--ablations", "free-space=much"], "free_space must be a float, got 'much'"),
        (["--ablations", "early-stop=on"], "There is no change 'early-stop=on'"),
        (["--ablations", "start-splats=a.ply"], "There is no change 'start-splats=a.ply'"),
        (["--ablations", "depth-weight=2"], "There is no change 'depth-weight=2'"),
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
    monkeypatch.setattr("gscore.bench.time_error.train_measured", None)
    peer = str(_peer(tmp_path / "peer.json", capture="horse"))
    given = [peer if option == "PEER" else option for option in options]
    out = tmp_path / "out"
    assert main(["bench", "time-error", str(EXAMPLE), *given, "-o", str(out)]) == 2
    assert words in capsys.readouterr().err and not out.exists()


def test_finished_measurements_are_kept(
    small: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Oracle: two of three presets trained, repeated ones once, when Ctrl-C comes."""
    labels_done = []

    def trained(config: TrainConfig, *_: object, **__: object) -> Trained:
        if len(labels_done) == 2:
            raise KeyboardInterrupt
        labels_done.append(config.max_splats)
        points = [_point(1, 20), _point(2, float("nan"))]
        splats = synthetic_scene(1)[0]
        return Trained(
            seconds=2, points=points, forward_pairs=1, backward_pairs=1, splats=splats, near=0.01
        )

    monkeypatch.setattr("gscore.bench.time_error.train_measured", trained)
    options = [str(EXAMPLE), *small, "--seeds", "3", "3", "--presets", "draft", "preview", "draft"]
    command = ["bench", "time-error", *options, "--ablations", "mcmc", "-o", str(tmp_path / "o")]
    assert main(command) == 130
    found = json.loads(
        (tmp_path / "o" / "results.json").read_text(), parse_constant=lambda name: 1 / 0
    )
    assert found["gscore"] == gscore.__version__ and not found["finished"]
    assert found["seeds"] == [3]
    capture = found["captures"]["studio"]
    assert capture["held_out"] == [Path(small[5]).read_text().strip()]
    curves = capture["curves"]
    assert [c["label"] for c in curves] == ["draft", "draft mcmc"]
    assert curves[0]["trained_width"] == 160 and curves[0]["iterations"] == 12
    assert curves[0]["max_splats"] == 150_000 and len(curves[0]["seeds"]) == 1
    assert curves[0]["seeds"][0][1]["psnr"] is None
    capsys.readouterr()


def test_presets_are_evaluated_at_one_size() -> None:
    """Oracle: the requested widths; evaluation on the larger photos, with equal ones read once."""
    data = PRESETS["preview"](EXAMPLE)[0]
    data = replace(data, mask_mode="none", test_every=20, eval=True)
    widths = [60, 120, 60, 120]

    def opened(*widths: int) -> tuple[list[Dataset], list[Dataset]]:
        sizes = [("", replace(data, max_width=width), TrainConfig()) for width in widths]
        variants = open_variants(sizes)
        return [one.photos for one in variants], [one.eval_views for one in variants]

    found, evaluated = opened(*widths)
    assert [int(p.scene.cameras.widths[0]) for p in found] == widths
    assert all(one is found[1] is found[3] for one in evaluated) and found[0] is found[2]
    wide, _ = opened(10_000, 20_000)
    assert wide[0] is wide[1]
