"""Environment variables of the native library; oracle: sentences, exit codes, no traceback."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from gscore.raster import native_library

ROOT = Path(__file__).parents[2]
DRAW = """
import sys
import numpy as np, gscore
splats = gscore.Splats(
    **{k: np.ones(s, np.float32) for k, s in dict(means=(1, 3), quats=(1, 4), scales=(1, 3),
       opacities=(1,), sh0=(1, 1, 3), shN=(1, 0, 3)).items()})
try:
    gscore.render(splats, np.diag([9.0, 9.0, 1.0]), np.eye(4), 4, 4)
except gscore.GsError as error:
    sys.exit(f"{type(error).__name__}: {error}")
from gscore.raster import native_library
sys.stdout.write(f"{native_library.isa()} {native_library.default_threads()}")
"""


def _python(*arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    clean = {k: v for k, v in os.environ.items() if not k.startswith("GSCORE_")}
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        env=clean | {"PYTHONPATH": str(ROOT)} | variables,
        timeout=120,
        check=False,
    )


def _refused(variables: dict[str, str], error: str, *words: str) -> None:
    """Check that a script gets `error` with all `words` in a sentence."""
    done = _python("-c", DRAW, **variables)
    assert done.returncode == 1 and done.stderr.startswith(f"{error}: "), done.stderr
    assert "Traceback" not in done.stderr
    for word in words:
        assert word in done.stderr


@pytest.mark.parametrize("name", ["GSCORE_THREADS", "GSCORE_ISA", "GSCORE_LIBRARY"])
def test_the_command_line_says_it_in_a_sentence(name: str) -> None:
    """Oracle: exit code 2 and the variable's name; `doctor` calls it a problem."""
    value = _other_library() if name == "GSCORE_LIBRARY" else "many"
    done = _python("-m", "gscore", "bench", "raster", **{name: value})
    assert done.returncode == 2 and done.stderr.startswith("gscore bench: error: ")
    assert name in done.stderr and "Traceback" not in done.stderr
    if name == "GSCORE_LIBRARY":
        done = _python("-m", "gscore", "doctor", **{name: value})
        assert done.returncode == 2 and name in done.stdout and not done.stderr


@pytest.mark.parametrize("text", ["many", "-1", "1025"])
def test_threads_that_cannot_be_are_named(text: str) -> None:
    """Oracle: the variable, the allowed values and the given one."""
    wanted = "GSCORE_THREADS must be a whole number from 0 (all cores) to 1024"
    _refused({"GSCORE_THREADS": text}, "ConfigError", wanted, f"'{text}'")


@pytest.mark.parametrize(("text", "threads"), [("3", 3), ("0", None)])
def test_threads_of_the_environment_are_used(text: str, threads: int | None) -> None:
    """Oracle: the number; all cores for 0 and an empty value."""
    done = _python("-c", DRAW, GSCORE_THREADS=text)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[1] == str(threads or cores)


def test_an_instruction_set_that_is_not_there_is_named() -> None:
    """Oracle: the variable, the requested set and the available ones; an available one is used."""
    there = native_library.available_isas()
    _refused({"GSCORE_ISA": "vax"}, "ConfigError", "GSCORE_ISA", "'vax'", ", ".join(there))
    assert _python("-c", DRAW, GSCORE_ISA=there[-1]).stdout.split()[0] == there[-1]


def _other_library() -> str:
    """A library that is not ours: the one of Python's decimals."""
    import _ctypes

    return _ctypes.__file__


@pytest.fixture
def not_ours(tmp_path: Path) -> dict[str, str]:
    """Paths that are no library of gscore, by kind."""
    text, folder = tmp_path / "notes.txt", tmp_path / "folder"
    text.write_text("not a library")
    folder.mkdir()
    broken, own = tmp_path / "broken.so", native_library.library_path()
    broken.write_bytes(own.read_bytes()[:40])
    whole = own.read_bytes()
    for name, length in (("half", len(whole) // 2), ("nearly", len(whole) - 1)):
        (tmp_path / f"{name}.so").write_bytes(whole[:length])
    locked_out = "/" + "x" * 5000
    found = {
        "text": str(text),
        "folder": str(folder),
        "broken": str(broken),
        "half": str(tmp_path / "half.so"),
        "nearly": str(tmp_path / "nearly.so"),
        "other": _other_library(),
        "missing": str(tmp_path / "none.so"),
        "too long": locked_out,
    }
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe")
        found["pipe"] = str(tmp_path / "pipe")
    return found


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("text", "notes.txt (GSCORE_LIBRARY) cannot be loaded as a library on this system"),
        ("folder", "folder (GSCORE_LIBRARY) is not a file, expected a library"),
        ("broken", "broken.so (GSCORE_LIBRARY) cannot be loaded as a library on this system"),
        *(
            pytest.param(
                name,
                f"{name}.so (GSCORE_LIBRARY) is truncated: ",
                marks=pytest.mark.skipif(sys.platform != "linux", reason="other systems refuse it"),
            )
            for name in ("half", "nearly")
        ),
        ("other", "is not gscore's library: it has no gs_abi_version"),
        ("missing", "none.so (GSCORE_LIBRARY) cannot be opened: there is no such file"),
        ("too long", "(GSCORE_LIBRARY) cannot be opened: the name is too long"),
        ("pipe", "pipe (GSCORE_LIBRARY) is not a file"),
    ],
)
def test_a_library_that_is_not_ours_is_named(
    not_ours: dict[str, str], kind: str, words: str
) -> None:
    """Oracle: the path, its kind and the expected library; no wait for a pipe."""
    if kind not in not_ours:
        pytest.skip("this system has no named pipes")
    more = "The environment variable GSCORE_LIBRARY must be the path of gscore's native library"
    _refused({"GSCORE_LIBRARY": not_ours[kind]}, "BackendError", words, more)


def test_a_library_in_the_working_folder_needs_no_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: a picture. The system would search a bare name in its own folders only."""
    shutil.copy(native_library.library_path(), tmp_path / "mine.so")
    monkeypatch.chdir(tmp_path)
    done = _python("-c", DRAW, GSCORE_LIBRARY="mine.so")
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["GSCORE_THREADS", "GSCORE_ISA", "GSCORE_LIBRARY"])
def test_empty_variables_count_as_not_set(name: str) -> None:
    """Oracle: the library in use without the variable."""
    done = _python("-c", DRAW, **{name: ""})
    assert (done.returncode, done.stdout) == (0, _python("-c", DRAW).stdout), done.stderr
