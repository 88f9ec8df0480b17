"""Oracle: real Pythons and virtual environments, and fakes of broken ones."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import tomllib
import venv
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest
from packaging.requirements import Requirement

from addon import preferences
from addon.process.background_task import BackgroundTask
from addon.trainer_python import environment, installer, pins, setup
from addon.trainer_python.environment import Verdict, check, find, python_in

ROOT = Path(__file__).parents[3]
REAL = os.environ.get("GSCORE_TRAINER_PYTHON", "")
needs_trainer = pytest.mark.skipif(not REAL, reason="GSCORE_TRAINER_PYTHON names no Python")


def program(path: Path, body: str) -> Path:
    """A shell script in place of a Python."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(0o755)
    return path


def answer(**facts: object) -> str:
    """Shell code that prints the output of `gscore doctor --json`."""
    base = {"gscore": "0.1.0", "python": "3.12.1", "can_train": True, "missing": []}
    base |= {"native": {"isa": "avx2", "threads": 4}, "packages": {"torch": {"version": "2.9"}}}
    return f"echo '{json.dumps(base | facts)}'"


def run(function: Callable[[BackgroundTask], object], timeout: float = 60.0) -> BackgroundTask:
    """Run a task and wait for it."""
    task = BackgroundTask(function)
    assert task.wait(timeout)
    return task


@pytest.fixture
def prefs() -> Iterator[preferences.Preferences]:
    """The preferences, restored after the test."""
    found = preferences.get()
    before = (found.python_path, found.found_python, found.torch_source)
    yield found
    found.python_path, found.found_python, found.torch_source = before
    setup.CURRENT.shut_down()


@pytest.fixture
def alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A PATH with one empty folder, and no other environment."""
    monkeypatch.setenv("PATH", str(tmp_path / "path"))
    for name in ("VIRTUAL_ENV", "CONDA_PREFIX"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "path").mkdir()
    return tmp_path / "path"


def verdict(task: BackgroundTask) -> Verdict:
    """Result of a check."""
    assert isinstance(task.result, Verdict), task.problem
    return task.result


@needs_trainer
def test_a_python_that_trains() -> None:
    """Oracle: the trainer's own Python."""
    found = verdict(run(lambda task: check(Path(REAL), task)))
    assert found.good, found.sentence
    assert found.facts["can_train"] is True
    assert "Ready: gscore" in found.sentence and "torch 2" in found.sentence


def test_a_python_without_gscore(tmp_path: Path) -> None:
    """Oracle: an empty virtual environment."""
    venv.create(tmp_path / "v", with_pip=False)
    found = verdict(run(lambda task: check(python_in(tmp_path / "v"), task)))
    assert not found.good
    assert "cannot run gscore" in found.sentence and "No module named gscore" in found.sentence
    assert "press Make Environment" in found.sentence


def test_a_python_without_torch(tmp_path: Path) -> None:
    """Oracle: this Python, which has gscore by a .pth file and no torch."""
    venv.create(tmp_path / "v", system_site_packages=True, with_pip=False)
    site = next((tmp_path / "v").glob("[lL]ib*/**/site-packages"))
    (site / "checkout.pth").write_text(f"{ROOT}\n{bpy_site()}\n")
    found = verdict(run(lambda task: check(python_in(tmp_path / "v"), task)))
    assert not found.good
    assert "cannot train without" in found.sentence and "torch" in found.sentence


def bpy_site() -> Path:
    """Folder of numpy and plyfile of the tests' Python."""
    import plyfile

    return Path(plyfile.__file__).parent


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("echo 'kaputt' >&2; exit 3", "cannot run gscore (kaputt)"),
        ('echo \'{"can_train": "\'', "cannot run gscore"),
        ("kill -9 $$", "cannot run gscore"),
        (answer(can_train=False, missing=["torch", "scipy"]), "without torch, scipy"),
        (answer(can_train=False, missing=["torch"], install="pip x"), "install there: pip x"),
        ("echo noise\n" + answer() + "\necho more", "Ready: gscore 0.1.0, Python 3.12.1"),
    ],
)
def test_strange_answers(tmp_path: Path, body: str, words: str) -> None:
    """Oracle: an error for each."""
    python = program(tmp_path / "python", body)
    assert words in verdict(run(lambda task: check(python, task))).sentence


def test_a_python_that_hangs(tmp_path: Path) -> None:
    """Oracle: an error after the limit; its process has ended. The same when cancelled."""
    python = program(tmp_path / "python", f"echo $$ > {tmp_path}/pid; exec sleep 600")
    found = verdict(run(lambda task: check(python, task, timeout=0.5)))
    assert "did not answer" in found.sentence
    (tmp_path / "pid").unlink(missing_ok=True)
    task = BackgroundTask(lambda task: check(python, task))
    until = time.monotonic() + 60
    while not ((tmp_path / "pid").is_file() and (tmp_path / "pid").read_text()):
        assert task.running and time.monotonic() < until
        time.sleep(0.01)
    task.cancel()
    assert task.wait(60) and task.cancelled
    pid = int((tmp_path / "pid").read_text())
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_no_python_at_all(tmp_path: Path) -> None:
    """Oracle: errors for a missing path and for a file that is not a program."""
    (tmp_path / "text").write_text("x")
    for path in (tmp_path / "missing", tmp_path / "text"):
        found = verdict(run(lambda task, path=path: check(path, task)))
        assert "cannot be run" in found.sentence and not found.good


def test_the_first_that_can_train_is_found(alone: Path, tmp_path: Path) -> None:
    """Oracle: the order: own environment, next to the command gscore, on the PATH."""
    path_python = program(alone / "python3", answer())
    found = verdict(run(lambda task: find(task, private=tmp_path / "own")))
    assert found.python == str(path_python)
    beside = tmp_path / "elsewhere"
    program(beside / "python", answer())
    program(beside / "gscore", "exit 0")
    (alone / "gscore").symlink_to(beside / "gscore")
    found = verdict(run(lambda task: find(task, private=tmp_path / "own")))
    assert found.python == str(beside / "python")
    own = program(python_in(tmp_path / "own"), answer())
    found = verdict(run(lambda task: find(task, private=tmp_path / "own")))
    assert found.python == str(own)


def test_one_that_lacks_torch_is_named_if_none_can(alone: Path, tmp_path: Path) -> None:
    """Oracle: the verdict on it rather than "nothing found"."""
    program(alone / "python3", "exit 1")
    program(alone / "python3.12", answer(can_train=False, missing=["torch"]))
    found = verdict(run(lambda task: find(task, private=None)))
    assert found.python.endswith("python3.12") and "without torch" in found.sentence


def test_a_chosen_python_is_the_only_one(alone: Path, tmp_path: Path) -> None:
    """Oracle: the chosen one is reported as bad despite a good one on the PATH; also for
    folders."""
    program(alone / "python3", answer())
    chosen = program(tmp_path / "bad" / "bin" / "python", "exit 1")
    for text in (str(chosen), str(tmp_path / "bad")):
        found = verdict(run(lambda task, text=text: find(task, chosen=text)))
        assert found.python == str(chosen) and not found.good


def test_finding_fills_the_preferences(
    prefs: preferences.Preferences, alone: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Oracle: the Python of the next training; the user's choice takes precedence."""
    monkeypatch.setattr(setup, "private_folder", lambda: tmp_path / "own")
    prefs.python_path = prefs.found_python = ""
    with pytest.raises(ValueError, match="press Find or Make Environment"):
        setup.trainer_python(prefs)
    python = program(alone / "python3", answer())
    assert bpy.ops.gscore.check_trainer(wait=True) == {"FINISHED"}
    assert setup.trainer_python(prefs) == python
    assert setup.CURRENT.verdict is not None and setup.CURRENT.verdict.good
    prefs.python_path = str(program(tmp_path / "mine", answer()))
    assert setup.CURRENT.verdict is None  # it belonged to another Python
    assert setup.trainer_python(prefs) == tmp_path / "mine"


def test_a_check_of_another_python_makes_way(
    prefs: preferences.Preferences, tmp_path: Path
) -> None:
    """Oracle: the Python of the verdict, although the check of the first takes a minute."""
    prefs.python_path = str(program(tmp_path / "slow", "exec sleep 600"))
    slow = setup.CURRENT.start_check(prefs)
    good = prefs.python_path = str(program(tmp_path / "good", answer()))
    assert setup.CURRENT.check(prefs).python == good
    assert slow.wait(60) and slow.cancelled
    assert setup.CURRENT.verdict is not None and setup.CURRENT.verdict.python == good


def test_a_bad_check_is_an_error_report(prefs: preferences.Preferences, tmp_path: Path) -> None:
    """Oracle: the operator's report."""
    prefs.python_path = str(program(tmp_path / "bad", "echo nope >&2; exit 1"))
    with pytest.raises(RuntimeError, match="cannot run gscore"):
        bpy.ops.gscore.check_trainer(wait=True)


def test_no_download_without_permission(prefs: preferences.Preferences) -> None:
    """Oracle: Blender's own switch, which is off in a fresh profile."""
    assert not bpy.app.online_access
    with pytest.raises(RuntimeError, match="Allow Online Access"):
        bpy.ops.gscore.make_environment(wheel=__file__, wait=True)
    assert not setup.CURRENT.busy()


def test_progress_is_redrawn(prefs: preferences.Preferences) -> None:
    """Oracle: one redraw for the first line, one for each new one, and one at the end."""
    going, line = threading.Event(), threading.Event()

    def install(task: BackgroundTask) -> None:
        task.report("Downloading: 1 of 2 MB")
        line.set()
        going.wait(60)
        raise ValueError("The network is down.")

    setup.CURRENT._making = task = BackgroundTask(install)
    try:
        assert line.wait(60)
        assert [setup.CURRENT.collect(prefs) for _ in range(2)] == [True, False]
        task.report("Downloading: 2 of 2 MB")
        assert [setup.CURRENT.collect(prefs) for _ in range(2)] == [True, False]
    finally:
        going.set()
        assert task.wait(60)
    assert [setup.CURRENT.collect(prefs) for _ in range(2)] == [True, False]
    assert setup.CURRENT.make_problem == "The network is down."
    setup.CURRENT.make_problem = ""


def test_a_wheel_is_needed(prefs: preferences.Preferences, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the error of a copy that was not installed from the zip file."""
    monkeypatch.setattr(installer, "find_wheel", lambda *_: None)
    with pytest.raises(RuntimeError, match="has no gscore"):
        bpy.ops.gscore.make_environment()


def test_the_wheel_of_this_system_is_chosen(tmp_path: Path) -> None:
    """Oracle: the file names, among wheels for other systems."""
    names = ("win_amd64", "macosx_11_0_arm64", "manylinux_2_28_x86_64", "manylinux_2_28_aarch64")
    for name in names:
        (tmp_path / f"gscore-1.2-py3-none-{name}.whl").write_bytes(b"")
    wheel = installer.find_wheel([tmp_path / "missing", tmp_path], "1.2")
    machine = "aarch64" if os.uname().machine in ("aarch64", "arm64") else "x86_64"
    assert wheel == tmp_path / f"gscore-1.2-py3-none-manylinux_2_28_{machine}.whl"
    assert installer.find_wheel([tmp_path], "1.3") is None


def fake_base(folder: Path, pip: str, doctor: str = answer()) -> Path:
    """A fake Python whose `-m venv` makes an environment whose `-m pip` runs the shell code
    `pip`."""
    inner = folder / "inner"
    case = f'case "$2" in\npip) {pip} ;;\ngscore) {doctor} ;;\nesac'
    program(inner, case)
    return program(folder / "python3", f'mkdir -p "$3/bin" && cp "{inner}" "$3/bin/python"')


def make(target: Path, base: Path, **kwargs: object) -> BackgroundTask:
    """Make an environment with a fake base, and wait for it."""
    values = {"online": True, "base": base} | kwargs
    wheel = target.parent / "gscore.whl"
    return run(lambda task: installer.make(target, wheel, task, **values))


def leftovers(target: Path) -> list[str]:
    """Names next to the target with the same prefix."""
    return sorted(p.name for p in target.parent.iterdir() if p.name.startswith(target.name))


def test_an_environment_replaces_the_earlier_one(tmp_path: Path) -> None:
    """Oracle: the listing before and after; pip's progress in megabytes."""
    target = tmp_path / "trainer"
    (target / "old").mkdir(parents=True)
    pip = "echo Collecting torch; echo Progress 50000000 of 200000000"
    task = make(target, fake_base(tmp_path, pip))
    assert task.result == python_in(target), task.problem
    assert not (target / "old").exists()
    assert leftovers(target) == ["trainer"]
    assert "Downloading: 50 of 200 MB" in task.lines and task.last_line == "Done"


@pytest.mark.parametrize(
    ("pip", "words"),
    [
        ("echo 'ERROR: [Errno 28] No space left on device' >&2; exit 1", "The disk is full"),
        (
            "echo 'WARNING: Retrying NewConnectionError(Temporary failure in name resolution)' >&2;"
            " echo 'ERROR: No matching distribution found for torch' >&2; exit 1",
            "registry cannot be reached",
        ),
        (
            "echo \"WARNING: NameResolutionError(HTTPSConnection(host='pypi.org', port=443))\" >&2;"
            " exit 1",
            "pypi.org cannot be reached; check the network and proxy of this computer, then",
        ),
        (
            "echo \"NameResolutionError(host='download.pytorch.org', port=443)\" >&2; exit 1",
            "download.pytorch.org cannot be reached; check the network and proxy of this computer, "
            "or choose Default Build",
        ),
        (
            'echo "SSLError(SSLCertVerificationError(1, \'[SSL: CERTIFICATE_VERIFY_FAILED] " >&2;'
            " exit 1",
            "REQUESTS_CA_BUNDLE",
        ),
        ("echo 'ERROR: gscore.whl is not a supported wheel' >&2; exit 1", "not a supported wheel"),
        ("exit 1", "could not be made"),
    ],
)
def test_a_failed_installation_leaves_the_earlier_environment(
    tmp_path: Path, pip: str, words: str
) -> None:
    """Oracle: only its file exists; an error with the reason."""
    target = tmp_path / "trainer"
    (target / "old").mkdir(parents=True)
    task = make(target, fake_base(tmp_path, pip))
    assert task.result is None and words in task.problem, task.problem
    assert (target / "old").exists() and leftovers(target) == ["trainer"]


def test_an_environment_that_does_not_work_is_not_kept(tmp_path: Path) -> None:
    """Oracle: a negative result of doctor; nothing is left."""
    base = fake_base(tmp_path, "exit 0", answer(can_train=False, missing=["torch"]))
    task = make(tmp_path / "trainer", base)
    assert "does not work" in task.problem and "torch" in task.problem
    assert leftovers(tmp_path / "trainer") == []


def test_a_base_without_venv(tmp_path: Path) -> None:
    """Oracle: the error message of Debian's Python."""
    base = program(tmp_path / "python3", "echo 'Error: ensurepip is not available' >&2; exit 1")
    assert "python3-venv" in make(tmp_path / "trainer", base).problem


@pytest.mark.parametrize(("cpu", "needed"), [(True, 3), (False, 9)])
def test_too_little_space(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cpu: bool, needed: int
) -> None:
    """Oracle: GB of downloads and installed files as measured on Linux, 2.4 without CUDA and 8.2
    with it, which dialog and error state; nothing is started."""
    monkeypatch.setattr(pins, "system", lambda: "linux_x86_64")
    monkeypatch.setattr("sys.platform", "linux")
    usage = SimpleNamespace(free=needed * 10**9 - 1)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: usage)
    task = make(tmp_path / "trainer", tmp_path / "never", cpu=cpu)
    assert f"needs about {needed} GB" in task.problem
    assert leftovers(tmp_path / "trainer") == []
    text = " ".join(installer.contents(Path("gscore.whl"), tmp_path, cpu=cpu))
    assert f"needs {needed} GB" in text


def test_making_can_be_cancelled(tmp_path: Path) -> None:
    """Oracle: it ends within seconds although pip hangs, and leaves nothing."""
    base = fake_base(tmp_path, "exec sleep 600")
    target = tmp_path / "trainer"
    task = BackgroundTask(
        lambda task: installer.make(target, tmp_path / "w.whl", task, online=True, base=base)
    )
    while "Updating pip" not in task.lines:
        assert task.running, task.problem
        time.sleep(0.01)
    task.cancel()
    assert task.wait(60) and task.cancelled
    assert leftovers(target) == []


@pytest.fixture
def killed(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """Another process that hangs in pip while it makes an environment, and the environment."""
    number, target = tmp_path / "number", tmp_path / "trainer"
    base = fake_base(tmp_path / "other", f"echo $$ > {number}; exec sleep 600")
    code = (
        "import sys; from pathlib import Path; from types import SimpleNamespace\n"
        "from addon.trainer_python import installer\n"
        "task = SimpleNamespace(report=print, check=lambda: None)\n"
        "target, base = map(Path, sys.argv[1:])\n"
        "installer.make(target, target.parent / 'w.whl', task, online=True, base=base)\n"
    )
    other = subprocess.Popen([sys.executable, "-c", code, str(target), str(base)], cwd=ROOT)
    until = time.monotonic() + 60
    while not (number.is_file() and number.read_text().strip()):
        assert other.poll() is None and time.monotonic() < until
        time.sleep(0.05)
    yield other, target
    other.kill()
    other.wait(60)
    os.kill(int(number.read_text()), signal.SIGKILL)  # its pip, which no process ends any more


def test_remains_of_a_killed_setup_are_removed(
    killed: tuple[subprocess.Popen[str], Path], tmp_path: Path
) -> None:
    """Oracle: the listing while it runs, after its end, and after the next one; other folders
    stay."""
    other, target = killed
    alike = tmp_path / "trainer.mine.new"
    alike.mkdir()
    (part,) = [p for p in tmp_path.glob("trainer.*.new") if p != alike]
    refused = make(target, fake_base(tmp_path, "exit 0"))
    assert f"Another Blender (process {other.pid}) is making the environment" in refused.problem
    assert part.is_dir()
    other.kill()
    other.wait(60)
    assert part.is_dir()
    task = make(target, fake_base(tmp_path, "exit 0"))
    assert task.result == python_in(target), task.problem
    assert leftovers(target) == ["trainer", alike.name]


def test_an_environment_under_a_temporary_name_is_put_back(tmp_path: Path) -> None:
    """Oracle: the later of two is restored although the installation failed; it is removed if the
    target exists."""
    target = tmp_path / "trainer"
    for number, name in enumerate(("0badcafe", "12345678")):
        (tmp_path / f"trainer.{name}.old" / name).mkdir(parents=True)
        os.utime(tmp_path / f"trainer.{name}.old", (number, number))
    task = make(target, fake_base(tmp_path, "exit 1"))
    assert task.result is None and (target / "12345678").is_dir()
    assert leftovers(target) == ["trainer"]
    (tmp_path / "trainer.0badcafe.old").mkdir()
    make(target, fake_base(tmp_path, "exit 1"))
    assert (target / "12345678").is_dir() and leftovers(target) == ["trainer"]


def test_the_calls_of_pip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the command lines, word for word, and the environment variables of a fake pip."""
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setenv("PIP_EXTRA_INDEX_URL", "https://evil.example/simple")
    messages = tmp_path / "messages"
    pip = f'echo "$*" >> {messages}; echo "config=$PIP_CONFIG_FILE" >> {messages}'
    target = tmp_path / "trainer"
    task = make(target, fake_base(tmp_path, pip))
    assert task.result == python_in(target), task.problem
    lines = messages.read_text().splitlines()
    pinned, start = pins.FOLDER, "-m pip --no-input --disable-pip-version-check"
    rest = "--no-deps --only-binary :all: -r"
    assert lines[0::2] == [
        f"{start} install --require-hashes {rest} {pinned}/pip.txt",
        f"{start} --isolated install --index-url https://download.pytorch.org/whl/cpu "
        f"--progress-bar raw {rest} {pinned}/torch-cpu.txt",
        f"{start} install --require-hashes --progress-bar raw {rest} {pinned}/packages.txt",
        f"{start} install --no-deps --no-index {tmp_path}/gscore.whl",
    ]
    assert lines[1::2] == ["config=", f"config={os.devnull}", "config=", "config="]


def test_the_usual_torch_has_hashes() -> None:
    """Oracle: the command line on each system; except on Linux, both choices give the same one."""
    for system, cpu in (("linux", False), ("darwin", True), ("win32", True)):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("sys.platform", system)
            step = installer.steps(Path("py"), Path("w.whl"), cpu=cpu)[1]
        assert "--require-hashes" in step.arguments and "--index-url" not in step.arguments
        assert step.arguments[-1] == str(pins.FOLDER / "torch.txt") and not step.variables


def test_a_wrong_hash_is_a_sentence(tmp_path: Path) -> None:
    """Oracle: pip's error message."""
    words = "ERROR: THESE PACKAGES DO NOT MATCH THE HASHES FROM THE REQUIREMENTS FILE."
    task = make(tmp_path / "trainer", fake_base(tmp_path, f"echo '{words}' >&2; exit 1"))
    assert "differs from the one of this extension" in task.problem


def test_the_pins_are_exact_and_complete() -> None:
    """Oracle: pyproject.toml and constraints.txt, read with the library that pip uses."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    wanted = [*project["dependencies"], *extras["train"], *extras["lpips"]]
    lists = [pins.pip(), pins.rest(), pins.torch(cpu=False)]
    found: dict[str, list[Requirement]] = {}
    for pinned in lists:
        for entry in re.split(r"\n(?=[a-z])", re.sub(r"^#.*\n", "", pinned.text, flags=re.M)):
            requirement, *hashes = entry.replace(" \\\n    ", "\n").strip().split("\n")
            assert hashes and all(re.fullmatch(r"--hash=sha256:[0-9a-f]{64}", h) for h in hashes)
            pin = Requirement(requirement)
            assert [s.operator for s in pin.specifier] == ["=="], requirement
            found.setdefault(pin.name, []).append(pin)
    for text in wanted:
        asked = Requirement(text)
        for version in ("3.11", "3.12", "3.13", "3.14"):
            environment = {"python_version": version, "python_full_version": f"{version}.2"}
            pinned = [
                p for p in found[asked.name] if not p.marker or p.marker.evaluate(environment)
            ]
            ((exact,),) = [list(p.specifier) for p in pinned]
            assert asked.specifier.contains(exact.version), text
    (torch,) = found["torch"]
    assert str(torch).startswith((ROOT / "constraints.txt").read_text().split()[-1])
    (version,) = torch.specifier
    assert "torch" not in " ".join(pins.rest().packages)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.platform", "linux")
        assert pins.torch(cpu=True).packages == [f"torch {version.version}+cpu"]


def test_the_dialog_says_what_is_installed(
    prefs: preferences.Preferences, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: versions, sizes and sources of the pins; a system without pins is refused."""
    wheel = Path("gscore-0.1.0-py3-none-any.whl")
    for source, cpu in (("CPU", True), ("USUAL", False)):
        prefs.torch_source = source
        monkeypatch.setattr(pins, "system", lambda: "linux_x86_64")
        monkeypatch.setattr("sys.platform", "linux")
        text = " ".join(installer.contents(wheel, Path("/own/trainer"), cpu=cpu))
        torch, rest = pins.torch(cpu=cpu), pins.rest()
        assert "/own/trainer" in text and wheel.name in text
        assert f"about {torch.megabytes} MB, from {torch.index}" in text
        assert all(package in text for package in (*torch.packages, *rest.packages))
        assert torch.megabytes > 100 and rest.megabytes > 50
    with pytest.raises(RuntimeError, match="Allow Online Access"):
        bpy.ops.gscore.make_environment("INVOKE_DEFAULT", wheel=str(wheel))
    monkeypatch.setattr(pins, "system", lambda: "linux_riscv64")
    with pytest.raises(installer.SetupError, match="not made for this system"):
        installer.contents(wheel, Path("/own"), cpu=True)


@pytest.mark.slow
def test_an_environment_for_real(tmp_path: Path) -> None:
    """Oracle: gscore doctor in an environment made from a wheel and this machine's registry."""
    wheel = os.environ.get("GSCORE_WHEEL", "")
    if not wheel:
        pytest.skip("GSCORE_WHEEL names no wheel")
    task = BackgroundTask(
        lambda task: installer.make(
            tmp_path / "trainer", Path(wheel), task, online=True, base=Path(sys.executable)
        )
    )
    assert task.wait(1200)
    assert task.result == python_in(tmp_path / "trainer"), task.problem
    assert verdict(run(lambda t: check(task.result, t), 120)).good
    assert environment.candidates(private=tmp_path / "trainer")[0] == task.result
