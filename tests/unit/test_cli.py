"""The dispatcher; oracle: exit codes and single sentences on stderr."""

import argparse
import errno
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from gscore import commands
from gscore._version import __version__
from gscore.commands import train
from gscore.commands.terminal.run_job import OutputOptions, run_job
from gscore.config import TrainConfig
from gscore.datasets.dataset import map_threads
from gscore.errors import Cancelled, ConfigError, DatasetError
from gscore.events import Failed, from_line
from gscore.extras import install_hint, need


def test_no_verb_shows_the_verbs(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: all verbs with a line each; 2 without, 0 with --help."""
    assert commands.main([]) == 2
    assert commands.main(["--help"]) == 0
    out = capsys.readouterr().out
    for verb in ("train", "eval", "render", "info", "doctor", "bench"):
        assert out.count(f"\n  {verb} ") == 2


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: the version file."""
    assert commands.main(["--version"]) == 0
    assert capsys.readouterr().out == f"gscore {__version__}\n"


def test_a_verb_that_does_not_exist(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: the nearest verb as a proposal."""
    assert commands.main(["trian"]) == 2
    assert "did you mean `gscore train`?" in capsys.readouterr().err


def test_a_measurement_is_not_given(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: all choices, in the message."""
    assert commands.main(["bench"]) == 2
    assert "missing: WHAT, one of raster, step, skips, " in capsys.readouterr().err


def test_a_verb_that_is_left_out_of_an_installation(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: a verb without a file, as in the wheel of the Blender extension."""
    monkeypatch.setitem(commands.VERBS, "weigh", "weigh splats")
    assert commands.main(["weigh"]) == 2
    assert "`gscore weigh` is not part of this installation" in capsys.readouterr().err
    assert commands.main(["--help"]) == 0
    assert "weigh" not in capsys.readouterr().out


@pytest.mark.parametrize("verb", list(commands.VERBS))
def test_help_of_each_verb(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: exit code 0 and the program's name."""
    assert commands.main([verb, "--help"]) == 0
    assert f"usage: gscore {verb}" in capsys.readouterr().out


def test_underscores_are_dashes_in_names_only() -> None:
    """Oracle: names as argparse has them; values are unchanged."""
    given = ["--test_iterations", "7_000", "--max_splats=1_0", "-r", "a_b", "c_d"]
    expected = ["--test-iterations", "7_000", "--max-splats=1_0", "-r", "a_b", "c_d"]
    assert commands.dashed(given) == expected


def fake(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    """Let every verb fail with `error`."""

    def run(args: Any) -> int:
        raise error

    module = SimpleNamespace(add_arguments=lambda parser: None, run=run)
    monkeypatch.setattr(commands, "import_module", lambda *_: module)


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (DatasetError("No photos in x."), 2, "gscore info: error: No photos in x.\n"),
        (OSError(errno.ENOSPC, "full", "out/a.ply"), 2, "out/a.ply: the disk is full. Free some"),
        (OSError(errno.EROFS, "ro", "out/a.ply"), 2, "the disk is read-only"),
        (OSError(errno.EACCES, "no", "out/a.ply"), 2, "permission denied"),
        (MemoryError(), 2, "out of memory; try fewer splats"),
        (ModuleNotFoundError("no", name="torch"), 2, 'pip install "gscore[train]"'),
        (ModuleNotFoundError("no", name="av.video"), 2, 'pip install "gscore[video]"'),
        (ModuleNotFoundError("no", name="nonsense"), 1, "this is an error in gscore"),
        (RuntimeError("bug"), 1, "this is an error in gscore"),
        (OSError(errno.EIO, "io"), 1, "this is an error in gscore"),
    ],
)
def test_failures_become_a_code_and_a_sentence(
    error: BaseException,
    code: int,
    words: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Oracle: 2 for errors of the user, in one line; 1 with a traceback for the rest."""
    fake(monkeypatch, error)
    assert commands.main(["info"]) == code
    err = capsys.readouterr().err
    assert words in err
    assert ("Traceback" in err) == (code == 1)
    if code == 2:
        assert err.count("\n") == 1


def test_ctrl_c_outside_of_training(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: the shell's code for SIGINT, and a message."""
    fake(monkeypatch, KeyboardInterrupt())
    assert commands.main(["info"]) == 130
    assert capsys.readouterr().err == "Stopped.\n"


@pytest.mark.parametrize(
    ("quiet", "events", "err"),
    [
        (False, None, "Stopped before the first step; nothing was written.\n"),
        (True, None, ""),
        (False, "jsonl", ""),
    ],
)
def test_stopped_before_there_was_anything(
    quiet: bool, events: str | None, err: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: a sentence for people, an event for programs, no output where none is requested."""

    def work(show: Any, control: Any) -> None:
        raise Cancelled("while reading")

    result, code = run_job(OutputOptions(quiet=quiet, events=bool(events)), work)
    reported = capsys.readouterr()
    assert (result, code, reported.err) == (None, 3, err)
    assert ("Stopped before the first step; nothing was written." in reported.out) == bool(events)


@pytest.mark.parametrize(
    ("words", "raised", "event"),
    [
        ("train x -o y --iterations many", None, ("ConfigError", "expected a whole number", "")),
        ("train nowhere -o y", None, ("DatasetError", "nowhere", "")),
        ("eval x", ModuleNotFoundError(name="torch"), ("ModuleNotFoundError", "torch", "torch")),
        ("eval x", OSError(errno.ENOSPC, "no"), ("OSError", "the disk is full", "")),
        ("frames x", ZeroDivisionError("by 0"), ("ZeroDivisionError", "by 0", "")),
    ],
)
def test_every_error_is_an_event(
    words: str,
    raised: Exception | None,
    event: tuple[str, str, str],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Oracle: one event with the sentence on stderr, also before the work begins; none without
    `--events`."""
    if raised is not None:

        def fail(*_: object) -> None:
            raise raised

        monkeypatch.setattr(commands, "import_module", fail)
    code = commands.main([*words.split(), "--events=jsonl"])
    told = capsys.readouterr()
    (failed,) = [e for line in told.out.splitlines() if isinstance(e := from_line(line), Failed)]
    kind, text, package = event
    assert (failed.type, failed.package, bool(failed.install)) == (kind, package, bool(package))
    assert text in failed.message
    assert code == 1 or failed.message in " ".join(told.err.split())
    commands.main(words.split())
    assert capsys.readouterr().out == ""


def test_only_rank_0_sends_the_event_of_an_error(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the contract that rank 0 alone writes to stdout; all ranks report on stderr."""
    monkeypatch.setenv("WORLD_SIZE", "2")
    line = ["train", "x", "-o", "y", "--iterations", "many", "--events", "jsonl"]
    for rank, count in (("0", 1), ("1", 0)):
        monkeypatch.setenv("RANK", rank)
        assert commands.main(line) == 2
        told = capsys.readouterr()
        assert told.out.count('"event": "error"') == count
        assert told.err.count("expected a whole number") == 1


def test_a_missing_package_is_named_in_the_event(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the package and command of the error that the work raises."""
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    monkeypatch.setattr(commands, "import_module", lambda *_: need("pycolmap", "It"))
    assert commands.main(["sfm", "x", "--events", "jsonl"]) == 2
    failed = from_line(capsys.readouterr().out.splitlines()[-1])
    assert isinstance(failed, Failed) and failed.package == "pycolmap"
    assert failed.install == install_hint("pycolmap")


def test_help_is_a_verb_too(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: the output of --help, and the nearest verb for an unknown one."""
    for line, same in (("help", "--help"), ("help info", "info --help")):
        assert commands.main(line.split()) == 0
        reported = capsys.readouterr().out
        assert commands.main(same.split()) == 0
        assert reported == capsys.readouterr().out
    for line in ("trian", "help trian"):
        assert commands.main(line.split()) == 2
        reported = capsys.readouterr().err
        assert "there is no command 'trian'; did you mean `gscore train`?" in reported


def test_a_bad_option_is_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: one line, code 2, and a reference to the help."""
    assert commands.main(["train", "x", "-o", "y", "--iterations", "many"]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "--iterations: expected a whole number, got 'many'. See gscore train --help." in err


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("train x -o y --itertions 5", "--itertions: did you mean --iterations? See gscore train"),
        ("train x -o y --max_splat=5", "--max-splat: did you mean --max-splats? See"),
        ("train x -o y --seeed 1 --qiet", "did you mean --seed; --qiet: did you mean --quiet?"),
        ("bench step --thread 1", "--thread: did you mean --threads?"),
        ("train x -o y --zzz 1", "there is no option --zzz. See"),
        ("train x -o y --iters 5", "--iters: did you mean --iterations? See"),
        ("train x --iters 5", "--iters: did you mean --iterations? See"),
        ("train x -o y -Z", "unrecognized arguments: -Z. See"),
        ("train x -o y --preset fast", "there is no 'fast'; did you mean preview? There are: prev"),
        ("train x -o y --preset hihg", "there is no 'hihg'; did you mean high? There are: prev"),
        ("train x -o y --preset zzz", "there is no 'zzz'; there are: preview, draft, normal, high"),
        ("bench rastre", "there is no 'rastre'; did you mean raster? There are: raster, step"),
        ("train x -o y --refine-evry 3", "--refine-evry: did you mean --refine-every? See"),
        ("train x -o y --set lr_bost=1", "there is no option 'lr_bost'; did you mean lr_boost?"),
        ("train x -o y --set zzz=1", "there is no option 'zzz'; `gscore options` lists all."),
        ("train x -o y --set seed", "expected seed=VALUE, got 'seed'."),
        ("train x -o y --set seed=x", "argument --seed: expected a whole number, got 'x'."),
        ("train x -o y --set watchdog=maybe", "watchdog must be on or off, got 'maybe'."),
        ("train x -o y --set without=foo", "there is no 'foo'; there are: exact-cull, "),
        ("train x -o y --hold-out frist:3", "expected a number N of at least 2 (every N-th), "),
        ("train x -o y --max_spalts 3 --debgu", "--max-spalts: did you mean --max-splats? See"),
        ("sequence x -o y --set nxt_iterations=3", "did you mean next_iterations?"),
        ("options opactiy_reg", "with 'opactiy_reg'; did you mean opacity_reg?"),
        ("render run -o y --pth orbit", "--pth: did you mean --path? See gscore render"),
    ],
)
def test_a_mistyped_option(line: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: the nearest option in one line, as for verbs."""
    assert commands.main(line.split()) == 2
    err = capsys.readouterr().err
    assert words in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "word",
    [
        "--iterations={x}",
        "--iterations={one}",
        "--resolution={x}",
        "--set=seed={x}",
        "--threads={one}",
        "--test-iterations=1,{one}",
        "--{x}=3",
        "--iterations{x}",
        "{x}",
        "-r={x}",
        "-d={x} {x}",
    ],
)
def test_a_long_value_is_not_repeated(word: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: a message of a few lines, for any value."""
    filled = word.format(x="x" * 9000, one="1" * 9000)
    assert commands.main(["train", "nowhere", "-o", "nowhere either", filled]) == 2
    assert 0 < len(capsys.readouterr().err) < 1000


def test_names_keep_their_capitals(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: the spelling of COLMAP and PLY, also where a phrase becomes a sentence."""
    for line in ("train --help", "info --help"):
        assert commands.main(line.split()) == 0
    out = capsys.readouterr().out
    assert "COLMAP" in out and "Train splats from photos, with or without cameras" in out
    assert "Summarise a capture, photos, a video, a PLY or a run." in out


def test_every_option_of_a_training_is_explained(capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: the first sentences in config.py, with the defaults of its fields and presets."""
    parser = argparse.ArgumentParser()
    train.add_arguments(parser)
    texts = {
        action.dest: action.help for action in parser._actions if action.help != "==SUPPRESS=="
    }
    assert all(texts.values())
    assert texts["antialias"] == "draw splats smaller than a pixel fainter (off)"
    assert texts["threads"] == "CPU threads; auto: one per core that this process may use (auto)"
    assert "preview 1,500, draft 4,000, normal 7,000, high 15,000" in texts["iterations"]


@pytest.mark.parametrize("verb", ["train", "sequence"])
def test_help_is_short(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: the lines of the help that begin with an option: 40 at most, some of each group."""
    assert commands.main([verb, "--help"]) == 0
    out = capsys.readouterr().out
    flags = re.findall(r"^  (-.*?)(?:  |$)", out, flags=re.M)
    assert 30 <= len(flags) <= 40
    for word in ("--hold-out", "--set NAME=VALUE", "--iterations", "--depths", "--json"):
        assert word in out
    for word in ("--grow-grad", "--cap-max", "--test-every", "--white-background", "--ip"):
        assert word not in out
    assert ("--rig" in out) is (verb == "train")


@pytest.mark.parametrize("verb", list(commands.VERBS))
def test_the_text_of_an_option_fits_two_lines(
    verb: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the help at 80 columns: lines of text below each option or argument."""
    monkeypatch.setenv("COLUMNS", "80")
    assert commands.main([verb, "--help"]) == 0
    entries = re.split(r"^  (?=\S)", capsys.readouterr().out, flags=re.M)[1:]
    for entry in entries:
        first, *more = entry.splitlines()
        below = [line for line in more if line.startswith(" " * 24)]
        assert len(below) + ("  " in first.strip()) <= 2, entry


def test_extras_bring_what_is_said_to_be_missing() -> None:
    """Oracle: pyproject.toml; every package of the extras for users is known."""
    path = Path(__file__).parents[2] / "pyproject.toml"
    extras = tomllib.loads(path.read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    modules = {"pillow": "PIL"}
    for extra in ("train", "depth", "video", "blender"):
        for requirement in extras[extra]:
            package = re.split("[>=<]", requirement)[0]
            command = install_hint(modules.get(package, package))
            assert command.startswith(f'pip install "gscore[{extra}]"')
    assert install_hint("nonsense") == ""


def test_python_without_torch() -> None:
    """Oracle: a fresh interpreter in which torch cannot be imported: a sentence, and still the
    exception type that programs catch."""
    code = (
        "import sys; sys.modules['torch'] = None\nimport gscore\n"
        "try: gscore.rasterize\nexcept ImportError as error: print(error, error.name)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.startswith(
        'gscore.rasterize needs the package torch; install it with: pip install "gscore[train]"'
    )
    assert done.stdout.endswith(" torch\n")


def test_python_dash_m(tmp_path: Path) -> None:
    """Oracle: the same output as the installed command, from any folder; neither numpy nor torch is
    loaded."""
    code = (
        "import sys; from gscore.commands import main; main(['--help']); "
        "assert not {'numpy', 'torch'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, cwd=tmp_path)
    command = [sys.executable, "-m", "gscore", "--version"]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=tmp_path)
    assert done.stdout == f"gscore {__version__}\n"


@pytest.mark.parametrize(
    "arguments",
    [
        ["info", "n" * 300],
        ["train", "n" * 300, "-o", "out"],
        ["render", "n" * 300, "-o", "out"],
        ["eval", "n" * 300],
        ["depth", "n" * 300],
        ["sequence", "n" * 300, "-o", "out"],
    ],
)
def test_names_that_no_file_can_have(
    arguments: list[str], capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: Any
) -> None:
    """Oracle: exit code 2 and one sentence, as for any other missing name."""
    monkeypatch.chdir(tmp_path)
    assert commands.main(arguments) == 2
    reported = capsys.readouterr().err
    assert "name is too long" in reported and "Traceback" not in reported
    assert len(reported) < 600


@pytest.mark.parametrize(
    "verb", ["render x", "eval x", "depth x", "train x -o y", "bench raster", "bench step"]
)
@pytest.mark.parametrize("threads", ["-1", "1025", "100000000000", "many", "1.5"])
def test_threads_that_cannot_be_are_refused(
    verb: str, threads: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: exit code 2 and a sentence with the value, before any search for files."""
    assert commands.main([*verb.split(), f"--threads={threads}"]) == 2
    reported = capsys.readouterr().err
    assert "threads" in reported and threads in reported and "Traceback" not in reported
    assert len(reported.strip().splitlines()) == 1


@pytest.mark.parametrize("threads", [-1, 1025, 2**40])
def test_threads_that_cannot_be_are_refused_in_python(threads: int) -> None:
    """Oracle: the message, from every function with threads except the rasterizer."""
    message = r"threads must be 0 \(all cores\) to 1024, got"
    with pytest.raises(ConfigError, match=message):
        list(map_threads(abs, [1, 2, 3], threads=threads))
    with pytest.raises(ConfigError, match="threads must be"):
        TrainConfig(threads=threads)


@pytest.mark.parametrize("verb", ["info", "doctor", "train"])
def test_a_working_folder_that_was_removed(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verb: str
) -> None:
    """Oracle: one sentence and exit code 2, where Python finds no current folder."""
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    with pytest.raises(FileNotFoundError):
        Path.cwd()
    assert commands.main([verb, str(tmp_path)]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"gscore {verb}: error: The working folder was removed")


def test_little_is_imported_before_signals_are_handled():
    """Oracle: the modules that Python and `signal` alone load; a Ctrl-C during other imports would
    end in a traceback instead of 130 and "Stopped."."""
    root = str(Path(commands.__file__).parents[2])
    code = f"""
import os, signal, sys  # `site` loads os
sys.path.insert(0, {root!r})
before = set(sys.modules)
import gscore.__main__
print(*sorted(set(sys.modules) - before))
"""
    line = [sys.executable, "-S", "-c", code]
    found = subprocess.run(line, capture_output=True, text=True, check=True)
    mine = ["gscore", "gscore.__main__", "gscore._version", "gscore.ending_signals"]
    assert found.stdout.split() == mine


@pytest.mark.parametrize(
    "words",
    [
        ["train", "photos", "-o", "out", "--source-path"],
        ["train", "photos", "-o", "out", "--config"],
        ["sequence", "case", "-o", "out", "--config"],
        ["eval", "run", "--model-path"],
        ["render", "run", "-o", "out", "--model-path"],
        ["view", "run", "-o", "out.html", "--model-path"],
    ],
)
def test_long_arguments_are_not_repeated_whole(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: the length of the message, and an argument of 400 digits in it."""
    number = "9" * 400
    assert commands.main([*words, number]) == 2
    text = capsys.readouterr().err
    assert number[:100] in text and number not in text and len(text) < 400
