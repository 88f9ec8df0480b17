"""`gscore train` for people and programs; oracle: exit codes, lines and files."""

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gscore.commands import main
from gscore.commands import train as train_command
from gscore.commands.args.train_request import TrainRequest
from gscore.config import Background, Strategy
from gscore.config_file import load_config
from gscore.events import Done, Estimated, Event, Failed, Progress, Saved, from_line
from gscore.io.images.png import write_png
from gscore.io.images.read_image import read_image
from gscore.trainer.files.run_folder import RunFolder
from gscore.trainer.schedule import caps
from tests.forked import Forked

pytestmark = pytest.mark.usefixtures("fake_engine")

SHORT = ["--iterations", "12", "--max-splats", "200", "--sh-degree", "0"]


def test_json_is_the_last_line(
    capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: the keys that the documentation promises, in strict JSON."""
    arguments = ["train", str(capture), "-o", str(tmp_path / "o"), *SHORT, "--eval", "--json"]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    data = json.loads(out.splitlines()[-1])
    assert data["psnr"] > 5
    assert 0 < data["ssim"] < 1
    assert data["splats"] == 150
    assert data["train_seconds"] > 0
    assert data["peak_memory_bytes"] > 50_000_000
    assert data["lpips"] is None
    assert data["lpips_reason"]
    assert data["reason"] == "finished"
    assert data["split"] == "test"


def test_people_get_a_summary_and_programs_silence(
    capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: the content of each stream."""
    base = ["train", str(capture), "-o", str(tmp_path), *SHORT, "--overwrite"]
    assert main(base) == 0
    seen = capsys.readouterr()
    assert "Finished after 12 steps" in seen.out
    assert "8 training views: PSNR" in seen.out
    assert "8 training views, 0 test views" in seen.err and "step 12" not in seen.err
    assert "asked for" not in seen.out
    assert main([*base, "--quiet"]) == 0
    seen = capsys.readouterr()
    assert (seen.out, seen.err) == ("", "")


def test_the_summary_says_what_was_asked_for_and_not_reached(
    capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: a target far above reach, within a budget of half a second."""
    options = ["--preset", "preview", "--time-budget", "0.5", "--target-psnr", "90"]
    assert main(["train", str(capture), "-o", str(tmp_path), *options]) == 0
    seen = capsys.readouterr().out
    assert "Used the time budget after" in seen
    assert "The target of 90 dB was not reached." in seen
    assert main(["train", str(capture), "-o", str(tmp_path), "--without", "foo"]) == 2
    assert "there are: exact-cull" in capsys.readouterr().err


def test_options_reach_the_config_under_all_names(capture: Path, tmp_path: Path) -> None:
    """Oracle: config.json of the run, for a command line in the style of 3DGS."""
    arguments = f"""
        train -s {capture} -m {tmp_path} --iterations 4 --sh_degree 1 --lambda_dssim 0.3 -w
        --position_lr_init 0.001 --densify_grad_threshold 0.0005 --test_iterations 2 3
        --save_iterations 3 --checkpoint_iterations 2 --eval --quiet --disable_viewer
        --cap_max 170 --strategy mcmc --antialiasing --seed 5 --test_every 3
    """.split()
    assert main(arguments) == 0
    data, config = load_config(tmp_path / "config.json")
    assert data.source == capture
    assert (data.eval, data.test_every) == (True, 3)
    assert config.ssim_weight == 0.3
    assert (config.means_lr, config.grow_grad) == (0.001, 0.0005)
    assert (config.test_iterations, config.save_iterations) == ((2, 3), (3,))
    assert config.background is Background.WHITE
    assert config.strategy is Strategy.MCMC
    assert (config.max_splats, config.seed, config.antialias) == (170, 5, True)
    assert RunFolder(tmp_path).saved(3).is_file()
    assert RunFolder(tmp_path).checkpoint(2).is_file()
    header = (tmp_path / "point_cloud.ply").read_bytes()[:200]
    assert b"SplatRenderMode: mip" in header


def test_a_config_file_repeats_a_run(capture: Path, tmp_path: Path) -> None:
    """Oracle: equal bytes of the model; precedence of options on the command line."""
    assert main(["train", str(capture), "-o", str(tmp_path / "a"), *SHORT, "--quiet"]) == 0
    config = ["--config", str(tmp_path / "a/config.json"), "--quiet"]
    assert main(["train", "-o", str(tmp_path / "b"), *config]) == 0
    assert main(["train", "-o", str(tmp_path / "c"), *config, "--seed", "1"]) == 0
    a, b, c = ((tmp_path / x / "point_cloud.ply").read_bytes() for x in "abc")
    assert a == b
    assert a != c


def test_ensemble_is_reported(
    capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: 150 points of the capture, from which each model starts; the messages of a run of one
    model, before and after its evaluation."""
    one, two = tmp_path / "one", tmp_path / "two"
    words = ["train", str(capture), *SHORT, "--max-splats", "400"]
    assert main([*words, "-o", str(one), "--quiet"]) == 0
    assert main([*words, "-o", str(two), "--ensemble", "2"]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "300 splats to start with, the same 150 for each of 2 models; " in said
    assert main(["eval", str(two), "--quiet"]) == 0
    pages = [(folder / "report.html").read_text() for folder in (one, two)]
    assert ["<p>SH degree 0, 2 merged models</p>" in page for page in pages] == [False, True]
    capsys.readouterr()
    reported = []
    for folder in (one, two):
        assert main(["info", str(folder)]) == 0
        reported.append(", 2 models as one\n" in capsys.readouterr().out)
    assert reported == [False, True]
    page = tmp_path / "compare.html"
    assert main(["compare", str(one), str(two), "-o", str(page), "--quiet"]) == 0
    assert "<tr><th>Merged models</th><td>n/a</td><td>2</td>" in page.read_text()


def test_automatic_choices_are_stored_but_not_in_the_command(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the command line; it is kept in a resumed run and an evaluation."""
    monkeypatch.setattr(caps, "_FEWEST_STEPS", 5)
    typed = ["--preset", "draft", "--steps-a-photo", "2"]
    assert main(["train", str(capture), "-o", str(tmp_path), *typed, "--quiet"]) == 0
    reported = "16 of 4,000 steps are taken"

    def check() -> None:
        metrics = json.loads((tmp_path / "metrics.json").read_text())
        page = (tmp_path / "report.html").read_text()
        assert (metrics["steps"], metrics["asked"]) == (16, {"iterations": 4000})
        (section,) = re.findall('<section class="decisions">.*?</section>', page)
        assert section.count(reported) == 1 and "stereo" in section
        (command,) = re.findall('<pre class="command">(.*?)</pre>', page)
        assert command.endswith("--preset draft --steps-a-photo 2")

    check()
    (tmp_path / "metrics.json").unlink()
    assert main(["train", "-o", str(tmp_path), "--resume", "--quiet"]) == 0
    check()
    assert main(["eval", str(tmp_path), "--quiet"]) == 0
    check()


def test_each_model_may_have_what_photos_allow_one(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: 2 and 1 times 20 splats for each of 8 photos, of the requested 600."""
    monkeypatch.setattr(caps, "_FEWEST_SPLATS", 10)
    for models in (2, 1):
        out = tmp_path / str(models)
        words = ["train", str(capture), "-o", str(out), *SHORT, "--quiet", "--max-splats", "600"]
        words += ["--splats-a-photo", "20", "--ensemble", str(models)]
        assert main(words) == 0
        assert load_config(out / "config.json")[1].max_splats == models * 160
        metrics = json.loads((out / "metrics.json").read_text())
        assert metrics["asked"] == {"max_splats": 600} and metrics["splats"] <= models * 160


def test_a_run_that_photos_limit_goes_on_by_the_line_that_began_it(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the splats of the whole run; the command line without the limits lifted since."""
    monkeypatch.setattr(caps, "_FEWEST_SPLATS", 10)
    monkeypatch.setattr(caps, "_FEWEST_STEPS", 5)
    line = ["train", str(capture), "-o", str(tmp_path), "--quiet", "--sh-degree", "0"]
    line += ["--max-splats", "600", "--splats-a-photo", "20", "--steps-a-photo", "2"]
    assert main([*line, "--checkpoint-iterations", "8"]) == 0
    folder = RunFolder(tmp_path)
    whole = folder.point_cloud.read_bytes()
    assert main([*line, "--checkpoint-iterations", "8", "--resume"]) == 0, "it is complete"
    folder.checkpoint(16).unlink()
    folder.point_cloud.unlink()
    assert main([*line, "--resume"]) == 0
    assert folder.point_cloud.read_bytes() == whole
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["asked"] == {"iterations": 7000, "max_splats": 600}
    assert main([*line, "--max-splats", "500", "--resume"]) == 2
    assert main(["train", "-o", str(tmp_path), "--resume", "--iterations", "20", "--quiet"]) == 0
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["asked"] == {"max_splats": 600} and metrics["steps"] == 20
    assert not any("steps are taken" in sentence for sentence in metrics["decided"])
    assert any("160 of 600 splats" in sentence for sentence in metrics["decided"])


def test_resume_needs_no_options(capture: Path, tmp_path: Path) -> None:
    """Oracle: the config of the first part, with the new length."""
    first = ["train", str(capture), "-o", str(tmp_path), *SHORT, "--quiet", "--eval"]
    assert main(first) == 0
    again = ["train", "-o", str(tmp_path), "--resume", "--iterations", "20", "--quiet"]
    assert main(again) == 0
    data, config = load_config(tmp_path / "config.json")
    assert (config.iterations, config.max_splats, data.eval) == (20, 200, True)
    assert json.loads((tmp_path / "metrics.json").read_text())["steps"] == 20


def test_resuming_says_from_where_and_that_nothing_is_left(
    capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: the lines; bytes and times of the files where no work was left."""
    assert main(["train", str(capture), "-o", str(tmp_path), *SHORT, "--quiet"]) == 0
    again = ["train", "-o", str(tmp_path), "--resume"]
    assert main([*again, "--iterations", "15"]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "Resuming from step 12 of 15 with 150 splats, about 1 s of training left; " in said
    assert "to start with" not in said and "views" not in said and "exposed" not in said
    state = {p: (p.read_bytes(), p.stat().st_mtime_ns) for p in tmp_path.rglob("*") if p.is_file()}
    assert main(again) == 0
    reported = capsys.readouterr()
    assert "was complete already: finished after 15 steps" in reported.out
    assert reported.err == ""
    after = {p: (p.read_bytes(), p.stat().st_mtime_ns) for p in tmp_path.rglob("*") if p.is_file()}
    assert after == state
    assert main([*again, "--events", "jsonl"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    done = from_line(line)
    assert isinstance(done, Done)
    assert (done.reason, done.step, done.splats) == ("finished", 15, 150)
    (tmp_path / "point_cloud.ply").unlink()
    assert main([*again, "--quiet"]) == 0, "results that are missing are made"
    assert (tmp_path / "point_cloud.ply").read_bytes() == state[tmp_path / "point_cloud.ply"][0]


def test_resuming_with_other_options_says_which(
    capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: each changed option once, under its name, and the options that may change."""
    assert main(["train", str(capture), "-o", str(tmp_path), *SHORT, "--quiet"]) == 0
    again = ["train", "-o", str(tmp_path), "--resume", "--quiet"]
    assert main([*again, "-r", "20"]) == 2
    err = capsys.readouterr().err
    assert "another run: --resolution was -1, is 20. A resumed run takes its options from" in err
    assert "--iterations, --time-budget" in err
    assert "cameras" not in err
    assert main([*again, "--preset", "draft"]) == 2
    err = capsys.readouterr().err
    changed = "max_splats was 200, is 150000; ensemble was 2, is 1; ensemble_below was 0.35, is 0; "
    changed += "sh_degree was 0, is 2; drop_rate was 0.1, is 0; drop_below was 0.35, is 0"
    assert f"another run: {changed}. A resumed" in err
    same = ["--preset", "normal", *SHORT]
    assert main([*again, *same, "--iterations", "14"]) == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-o", "{out}"], "missing: source."),
        ([], "missing: source, -o."),
        (["--resume"], "missing: -o."),
        (["{capture}/nothing", "-o", "{out}"], "nothing"),
        (["{capture}/walk.mp4", "-o", "{out}"], "There is no video {capture}/walk.mp4."),
        (["{capture}", "-s", "elsewhere", "-o", "{out}"], "Two captures were given"),
        (["{capture}"], "missing: -o"),
        (["{capture}", "-o", "{out}", "--resume"], "contains no run to resume"),
        (["{capture}", "-o", "{out}", "--resume", "--overwrite"], "not allowed with argument"),
        (["{capture}", "-o", "{out}", "--start-checkpoint", "{out}/x"], "no such checkpoint"),
        (["{capture}", "-o", "{out}", "--config", "{out}/x.json"], "there is no such config"),
        (["{capture}", "-o", "{out}", "--max-splats", "0"], "max_splats must be 1 to 1000000000"),
        (["{capture}", "-o", "{out}", "--lpips", "{out}/x.onnx"], "There is no LPIPS network"),
        (["{capture}", "-o", "{out}", "-r", "0.5"], "resolution is 0.5"),
        (["{capture}", "-o", "{out}", "--debug"], "no debug dumps"),
        (["{capture}", "-o", "{out}", "--test-every", "6", "--test-last", "3"], "give one of them"),
        (["{capture}", "-o", "{out}", "--hold-out", "6", "--test-last", "3"], "give one of them"),
        (["{capture}", "-o", "{out}", "--hold-out", "gone.txt"], "gone.txt"),
        (
            ["{capture}", "-o", "{out}", "--set", "max_splats=0"],
            "max_splats must be 1 to 1000000000",
        ),
        (["{capture}", "-o", "{out}", "--time-budget", "5", "--iterations", "9"], "budget (5 s)"),
        (["{capture}", "-o", "{out}", "-d", "nodepth"], "There is no folder {capture}/nodepth"),
        (["{capture}", "-o", "{out}", "-w", "--random-background"], "Give either"),
        (["{capture}", "-o", "{out}", "--nonsense"], "there is no option --nonsense"),
        (["{capture}", "-o", "{capture}/images/view_00.png"], "is a file"),
    ],
)
def test_bad_input_is_one_sentence_and_leaves_nothing(
    capture: Path, refused: Callable[..., None], arguments: list[str], message: str
) -> None:
    """Oracle: code 2, one line with the error, no output folder."""
    refused("train", arguments, message.format(capture=capture), capture=capture)


def test_depth_maps_are_missed_before_photos_are_read(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: no decoded photo."""
    monkeypatch.setattr("gscore.trainer.prepare.load_photos", lambda *a, **k: pytest.fail("read"))
    line = ["train", str(capture), "-o", str(tmp_path / "o"), "-d", "nodepth", "--quiet"]
    assert main(line) == 2


def test_a_way_to_split_takes_the_place_of_another(capture: Path, tmp_path: Path) -> None:
    """Oracle: the later option alone, over a config file with another."""
    line = ["train", str(capture), "-o", str(tmp_path / "a"), *SHORT, "--quiet"]
    assert main([*line, "--test-first", "1", "--test-last", "2"]) == 0
    config = tmp_path / "a" / "config.json"
    data, _ = load_config(config)
    assert (data.eval, data.test_first, data.test_last) == (True, 1, 2)
    parser = argparse.ArgumentParser()
    train_command.add_arguments(parser)
    other = f"-o out --config {config} --test-every 3"
    data, _ = TrainRequest.of(parser.parse_args(other.split())).configs()
    assert (data.eval, data.test_first, data.test_last, data.test_every) == (True, 0, 0, 3)


def test_a_place_that_is_refused_is_not_searched(
    capture: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: one sentence, without the files there."""
    assert main(["train", str(capture), "-o", "/", *SHORT]) == 2
    reported = capsys.readouterr()
    assert "is the root folder" in reported.err and "they stay" not in reported.err


def test_foreign_files_in_the_output_folder_are_reported(
    capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: their names, and unchanged files."""
    for name in "gfedcba":
        (tmp_path / f"{name}.jpg").write_text(name)
    assert main(["train", str(capture), "-o", str(tmp_path), *SHORT]) == 0
    reported = capsys.readouterr()
    said = reported.err
    assert (
        "contains other files, which are kept: a.jpg, b.jpg, c.jpg, d.jpg, e.jpg and 2 more" in said
    )
    assert f"Results: {tmp_path}/point_cloud.ply, {tmp_path}/report.html" in reported.out
    assert (tmp_path / "d.jpg").read_text() == "d"


def test_a_folder_that_is_refused_keeps_no_files(
    capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: one sentence about another run's folder."""
    line = ["train", str(capture), "-o", str(tmp_path / "out"), *SHORT]
    assert main([*line, "--quiet"]) == 0
    (tmp_path / "out" / "holiday.jpg").write_text("mine")
    capsys.readouterr()
    assert main(line) == 2
    err = capsys.readouterr().err
    assert "contains another run" in err and "they stay" not in err


def test_flags_of_3dgs_scripts_mean_what_they_mean_there() -> None:
    """Oracle: the 3DGS trainer's documentation of its options."""
    parser = argparse.ArgumentParser()
    train_command.add_arguments(parser)
    flags = "--ip 127.0.0.1 --port 6009 --debug-from -1 --disable-viewer --test-iterations -1"
    line = f"-s in -m out {flags} --feature-lr 0.01 --random-background --position-lr-init 0.002"
    _, config = TrainRequest.of(parser.parse_args(line.split())).configs()
    assert config.test_iterations == ()
    assert (config.sh0_lr, config.shN_lr, config.means_lr) == (0.01, 0.0005, 0.002)
    assert config.background is Background.RANDOM


def test_black_masks_are_refused_and_some_are_warned_about(
    capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: masks written here; the message where masks are in use."""
    shutil.copytree(capture, tmp_path / "in")
    masks = tmp_path / "in" / "masks"
    masks.mkdir()
    photos = sorted((tmp_path / "in" / "images").iterdir())
    for photo in photos:
        write_png(masks / photo.name, np.zeros(read_image(photo).shape[:2], np.uint8))
    run = ["train", str(tmp_path / "in"), "-o", str(tmp_path / "out"), *SHORT]
    assert main([*run, "--quiet"]) == 2
    assert "are black, so there are no pixels to train on" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    for photo in photos:
        write_png(masks / photo.name, np.full(read_image(photo).shape[:2], 255, np.uint8))
    assert main([*run, "--quiet", "--invert-masks"]) == 2
    assert "are white, so inverted they leave no" in capsys.readouterr().err
    write_png(masks / photos[0].name, np.zeros(read_image(photos[0]).shape[:2], np.uint8))
    for photo in photos[1:]:
        mask = np.zeros(read_image(photo).shape[:2], np.uint8)
        mask[:, ::2] = 255
        write_png(masks / photo.name, mask)
    assert main(run) == 0
    reported = capsys.readouterr()
    assert "The masks of 1 training view are black" in reported.err
    assert "PSNR inside the masks" in reported.out
    assert "masked pixels are neither trained nor measured" in reported.err


class Job:
    """A `gscore train --events jsonl` in another process."""

    def __init__(self, *arguments: str, stdin: Any = subprocess.PIPE) -> None:
        command = ["-m", "gscore", "train", *arguments, "--events", "jsonl"]
        self.process = Forked(command, stdin=stdin)
        self.events: list[Event] = []

    def until(self, kind: type[Event], condition: Callable[[Any], bool] = lambda e: True) -> Event:
        """Read events up to one of a kind."""
        for line in self.process.stdout:
            event = from_line(line)
            assert event is not None, line
            self.events.append(event)
            if isinstance(event, kind) and condition(event):
                return event
        pytest.fail(f"no {kind.__name__}; stderr: {self.process.stderr.read()}")

    def end(self) -> int:
        """Read to the end; return the exit code."""
        self.events += [e for line in self.process.stdout if (e := from_line(line))]
        return self.process.wait(timeout=60)


@pytest.fixture
def job(capture: Path, tmp_path: Path) -> Iterator[Callable[..., Job]]:
    """`start(*arguments)`: a very long run."""
    jobs: list[Job] = []

    def start(*arguments: str, **kwargs: Any) -> Job:
        base = [str(capture), "-o", str(tmp_path / "out"), "--max-splats", "200"]
        jobs.append(Job(*base, "--iterations", "10000000", *arguments, **kwargs))
        return jobs[-1]

    yield start
    for made in jobs:
        made.process.close()


def checkpoint_step(path: Path) -> int:
    return int(RunFolder(path).checkpoints()[-1].stem.removeprefix("step_"))


@pytest.mark.usefixtures("real_engine")
@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signals_end_with_a_checkpoint(
    job: Callable[..., Job], tmp_path: Path, number: signal.Signals, code: int
) -> None:
    """Oracle: the shell's exit code, a Done event, and a checkpoint that can be resumed."""
    run = job()
    run.until(Progress, lambda e: e.step > 5)
    run.process.send_signal(number)
    assert run.end() == code
    done = run.events[-1]
    assert isinstance(done, Done)
    assert done.reason == "interrupted"
    assert checkpoint_step(tmp_path / "out") == done.step
    assert (tmp_path / "out/point_cloud.ply").is_file()
    more = str(done.step + 3)
    assert main(["train", "-o", str(tmp_path / "out"), "--resume", "--iterations", more]) == 0
    assert checkpoint_step(tmp_path / "out") == done.step + 3


def test_stop_on_stdin_ends_well(job: Callable[..., Job], tmp_path: Path) -> None:
    """Oracle: code 0, reason, checkpoint."""
    run = job()
    run.until(Progress, lambda e: e.step > 5)
    run.process.stdin.write("stop\n")
    run.process.stdin.flush()
    assert run.end() == 0
    assert isinstance(run.events[0], Estimated)
    assert isinstance(run.events[-1], Done)
    assert run.events[-1].reason == "stopped"
    assert any(isinstance(e, Saved) for e in run.events)
    assert checkpoint_step(tmp_path / "out") == run.events[-1].step


def test_the_end_of_stdin_means_that_the_parent_died(
    job: Callable[..., Job], tmp_path: Path
) -> None:
    """Oracle: a checkpoint without a request."""
    run = job()
    run.until(Progress, lambda e: e.step > 5)
    run.process.stdin.close()
    assert run.end() == 0
    assert isinstance(run.events[-1], Done)
    assert run.events[-1].reason == "input ended"
    assert checkpoint_step(tmp_path / "out") == run.events[-1].step


def test_dev_null_as_stdin_does_not_end_a_run(capture: Path, tmp_path: Path) -> None:
    """Oracle: a run to its last step."""
    run = Job(str(capture), "-o", str(tmp_path / "out"), *SHORT, stdin=subprocess.DEVNULL)
    assert run.end() == 0
    assert isinstance(run.events[-1], Done)
    assert run.events[-1].reason == "finished"


def test_a_second_run_in_the_same_folder_is_refused(
    job: Callable[..., Job], capture: Path, tmp_path: Path
) -> None:
    """Oracle: the process that has locked the folder, named by the second; the first continues."""
    run = job()
    run.until(Progress, lambda e: e.step > 5)
    second = Job(str(capture), "-o", str(tmp_path / "out"), "--overwrite")
    assert second.end() == 2
    assert isinstance(second.events[-1], Failed)
    assert f"process {run.process.pid}" in second.events[-1].message
    run.until(Progress)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_events_that_cannot_be_written_end_the_run_in_order(capture: Path, tmp_path: Path) -> None:
    """Oracle: a device that is always full: no traceback, and at most a checkpoint."""
    command = ["-m", "gscore", "train", str(capture), "-o", str(tmp_path), *SHORT]
    with Path("/dev/full").open("w") as full:
        ended = Forked([*command, "--events", "jsonl"], stdout=full)
        _, err = ended.communicate(timeout=60)
    ended.close()
    assert "Traceback" not in err
    assert RunFolder(tmp_path).checkpoints() or not list(tmp_path.iterdir())


@pytest.mark.skipif(os.name == "nt", reason="limits of POSIX")
def test_a_write_that_fails_is_one_sentence(capture: Path, tmp_path: Path) -> None:
    """Oracle: a system limit of 20 kB on files, which fails in mid-write as a full disk would."""
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))\n"
        "from gscore.__main__ import main; sys.exit(main())"
    )
    ended = Forked(["-c", code, "train", str(capture), "-o", str(tmp_path), *SHORT, "--quiet"])
    _, err = ended.communicate(timeout=60)
    ended.close()
    assert ended.returncode == 2
    assert err.count("\n") == 1
    assert "gscore train: error: Cannot write" in err
    assert "checkpoints/step_00000000.safetensors" in err
    left = {p.name for p in tmp_path.rglob("*") if p.is_file()}
    assert left == {"config.json", "cfg_args", "cameras.json"}
