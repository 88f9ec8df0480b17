"""What each target installs and builds; oracle: make, which says or runs its commands."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from runpy import run_path

import pytest

ROOT = Path(__file__).parent.parent
LINTERS = ("ruff", "pyright", "clang-format", "check-jsonschema", "zizmor")
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


def make(*arguments: str | Path, **environment: str) -> str:
    """What make prints; it must end well. Settings of pip and of an outer make do not reach it."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PIP_", "MAKE", "MFLAGS"))}
    done = subprocess.run(
        ["make", *map(str, arguments)],
        cwd=ROOT,
        env=kept | {"PIP_CONFIG_FILE": os.devnull} | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture
def plan(tmp_path: Path) -> Callable[..., str]:
    """`plan(target, ...)`: the commands of a target where nothing is installed yet."""
    return lambda *words: make("-n", f"VENV={tmp_path / 'new'}", "DEMO_BLENDER=none", *words)


@pytest.mark.parametrize("target", ["install", "demo"])
def test_users_get_what_they_use(plan: Callable[[str], str], target: str) -> None:
    """Oracle: the commands: no linters, no test programs, the library once."""
    commands = plan(target)
    assert "--group dev" not in commands and "[dev]" not in commands
    assert "GS_TESTS=OFF" in commands and "GS_TESTS=ON" not in commands
    assert "wheel.cmake=false" in commands and commands.count("--build ") == 1


def test_warnings_of_pip_are_left_out(plan: Callable[[str], str]) -> None:
    """Oracle: the commands; -q leaves warnings in, -qq errors alone."""
    lines = [line for line in plan("lint").splitlines() if " -m pip " in line]
    assert len(lines) >= 4 and all(" -qq" in line for line in lines if "install" in line)


@pytest.mark.parametrize(("target", "tests"), [("lint", False), ("test", True)])
def test_developers_get_their_tools_too(
    plan: Callable[[str], str], target: str, tests: bool
) -> None:
    """Oracle: the commands; linting builds nothing, and looks at the workflows too."""
    commands = plan(target)
    if target == "lint":
        assert all(name in commands for name in LINTERS)
    assert "--group dev" in commands
    assert ("GS_TESTS=ON" in commands) is tests and ("--build " in commands) is tests


@pytest.mark.parametrize(
    ("changed", "target", "built"),
    [
        ("csrc/src/api.cpp", "install", "GS_TESTS=OFF"),
        ("csrc/src/blend_forward.inl.h", "demo", "GS_TESTS=OFF"),
        ("csrc/include/gscore.h", "test-native", "GS_TESTS=ON"),
        ("csrc/include/gscore/raster.h", "install", "GS_TESTS=OFF"),
        ("csrc/tests/test_native.cpp", "test-native", "GS_TESTS=ON"),
        ("csrc/tests/test_native.cpp", "install", ""),
        ("README.md", "test-native", ""),
    ],
)
def test_changed_sources_are_built_again(
    tmp_path: Path, changed: str, target: str, built: str
) -> None:
    """Oracle: the commands where everything is there and one file is new."""
    stamps = {name: tmp_path / name for name in ("INSTALLED", "LIBRARY", "NATIVE_TESTS")}
    for number, path in enumerate(stamps.values()):
        path.touch()
        os.utime(path, times=(2**31 + number, 2**31 + number))  # newer than any source
    words = (f"{name}={path}" for name, path in stamps.items())
    commands = make("-n", f"--what-if={changed}", "DEMO_BLENDER=none", *words, target)
    assert ("--build " in commands) is bool(built) and built in commands


def fake_pip(folder: Path, *, index: str) -> str:
    """A pip that writes down its arguments and runs `index` for calls that name an index."""
    script = folder / "pip"
    log = folder / "log"
    script.write_text(
        f'#!/bin/sh\necho "$*" >> {log}\ncase "$*" in *--index-url*) {index} ;; esac\n'
    )
    script.chmod(0o755)
    return str(script)


def environment_made(folder: Path, pip: str, *more: str) -> tuple[str, list[str]]:
    """What `make VENV/.installed` prints with this pip, and the arguments of every call of pip."""
    (folder / "new").mkdir()
    variables = ("PYTHON=true", f"PIP={pip}", f"VENV={folder / 'new'}", *more)
    reported = make("--silent", *variables, folder / "new/.installed")
    return reported, (folder / "log").read_text().splitlines()


linux = pytest.mark.skipif(sys.platform != "linux", reason="CUDA comes on Linux alone")


@linux
def test_torch_without_cuda_comes_first(tmp_path: Path) -> None:
    """Oracle: pip's arguments: PyTorch's index for torch alone, before everything else."""
    reported, calls = environment_made(tmp_path, fake_pip(tmp_path, index="true"))
    assert reported.count("\n") == 1 and reported.startswith("Installing into")
    first, rest = calls[1], calls[2:]
    assert "--index-url https://download.pytorch.org/whl/cpu " in first
    assert first.endswith("--constraint constraints.txt torch") and "--no-deps" in first
    assert len(rest) == 1 and "--editable .[all]" in rest[0] and "index-url" not in rest[0]


@linux
def test_without_the_cpu_build_the_usual_one_is_taken(tmp_path: Path) -> None:
    """Oracle: a pip that fails for that index: one sentence, and the installation goes on."""
    pip = fake_pip(tmp_path, index="exit 1")
    reported, calls = environment_made(tmp_path, pip, "TORCH_INDEX=https://example.org/torch")
    _, sentence = reported.splitlines()
    assert "2.7 GB" in sentence and "https://example.org/torch" in sentence
    assert "--editable .[all]" in calls[-1]


@linux
def test_no_index_can_be_asked_for(tmp_path: Path) -> None:
    """Oracle: pip's arguments with an empty TORCH_INDEX."""
    _, calls = environment_made(tmp_path, fake_pip(tmp_path, index="exit 1"), "TORCH_INDEX=")
    assert len(calls) == 2 and not any("index-url" in call for call in calls)


@linux
def test_an_index_that_refuses_costs_seconds(tmp_path: Path) -> None:
    """Oracle: pip's limits, a second try of 15 s each, for one package alone, and its connections
    to a port of this machine where nobody listens; the real pip."""
    log = tmp_path / "pip.log"
    real = f'{sys.executable} -m pip "$@" --dry-run --ignore-installed --log {log}'
    pip = fake_pip(tmp_path, index=real)
    reported, calls = environment_made(tmp_path, pip, "TORCH_INDEX=http://127.0.0.1:9/simple")
    assert "comes from PyPI" in reported
    (call,) = [call for call in calls if "--index-url" in call]
    assert "--retries 1 --timeout 15 --no-deps" in call and call.endswith(" torch")
    assert log.read_text().count("Retrying (Retry(") == 1


@linux
def test_an_index_that_refuses_is_one_sentence(tmp_path: Path) -> None:
    """Oracle: the lines of the terminal, errors among them: what is installed, and one sentence; a
    port of this machine where nobody listens and a name that nobody has; the real pip."""
    for folder, index in (("port", "http://127.0.0.1:9/simple"), ("name", "https://x.invalid/s")):
        own = tmp_path / folder
        own.mkdir()
        pip = fake_pip(own, index=f'{sys.executable} -m pip "$@" --dry-run --ignore-installed')
        reported, _ = environment_made(own, f"{pip} 2>&1", f"TORCH_INDEX={index}")
        assert [line.split()[0] for line in reported.splitlines()] == ["Installing", index]


def test_help_lists_every_target() -> None:
    """Oracle: .PHONY; plain `make` says the same, in lines a terminal shows whole."""
    (phony,) = re.findall(r"^\.PHONY: (.*)$", MAKEFILE, re.M)
    reported = make("help")
    lines = reported.splitlines()
    targets = [line.split()[1] for line in lines]
    assert targets == re.findall(r"^([a-z-]+):", MAKEFILE, re.M)
    assert set(targets) == set(phony.split())
    assert max(map(len, lines)) <= 120 and make() == reported


def test_slow_tests_of_the_add_on_run_too(plan: Callable[..., str]) -> None:
    """Oracle: the commands; those of one Blender, or none."""
    assert "test_blender.py newest -- -m slow" in plan("test-slow", "BLENDER=newest")
    assert "test_blender.py" not in make("-n", "test-slow", "BLENDER=none")


@pytest.mark.parametrize(
    ("given", "marks"),
    [
        ([], "graphics"),
        (["-m", "slow"], "(slow) and graphics"),
        (["-m", "a", "-k", "b"], "(a) and graphics"),
    ],
)
def test_other_backends_draw_what_was_asked_for(
    given: list[str], marks: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: pytest's rule that the last -m counts; the first backend runs what is given."""
    monkeypatch.syspath_prepend(str(ROOT / "tools" / "build"))
    chosen = run_path(str(ROOT / "tools" / "build" / "test_blender.py"))["chosen"]
    assert chosen("opengl", given) == ["-q", "tests/addon", *given]
    assert chosen("vulkan", given)[-2:] == ["-m", marks]
