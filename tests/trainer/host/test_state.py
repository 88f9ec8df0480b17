"""State that a host program, its user or its starter may have set; oracle: bits of an ordinary
run."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.trainer.small_work import work

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def ordinary(deep: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The results with default settings."""
    return work(deep, tmp_path_factory.mktemp("ordinary"))


@contextmanager
def _default_dtype(dtype: torch.dtype) -> Iterator[None]:
    before = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    try:
        yield
    finally:
        torch.set_default_dtype(before)


@contextmanager
def _default_device(device: str) -> Iterator[None]:
    torch.set_default_device(device)
    try:
        yield
    finally:
        torch.set_default_device(None)


@contextmanager
def _deterministic() -> Iterator[None]:
    torch.use_deterministic_algorithms(True)
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(False)


@contextmanager
def _recursion_limit() -> Iterator[None]:
    before, depth, frame = sys.getrecursionlimit(), 0, sys._getframe()
    while frame is not None:
        depth, frame = depth + 1, frame.f_back
    sys.setrecursionlimit(depth + 120)
    try:
        yield
    finally:
        sys.setrecursionlimit(before)


@contextmanager
def _umask() -> Iterator[None]:
    before = os.umask(0o077)
    try:
        yield
    finally:
        os.umask(before)


STATES: dict[str, tuple[Callable[[], AbstractContextManager[object]], ...]] = {
    "float64 by default": (lambda: _default_dtype(torch.float64), torch.no_grad, _umask),
    "bfloat16 by default, on another device": (
        lambda: _default_dtype(torch.bfloat16),
        lambda: _default_device("meta"),
        torch.inference_mode,
        _deterministic,
    ),
    "less precision, no patience": (
        lambda: torch.autocast("cpu", dtype=torch.bfloat16),
        lambda: np.errstate(all="raise"),
        _recursion_limit,
    ),
}
"""Each once; states of one line do not touch each other."""


@pytest.mark.parametrize("name", STATES)
def test_state_of_the_process_changes_no_bit(
    deep: Path, tmp_path: Path, ordinary: str, name: str
) -> None:
    """Oracle: splats, measurements, pictures and gradients of the run without it."""
    with ExitStack() as stack:
        for state in STATES[name]:
            stack.enter_context(state())
        found = work(deep, tmp_path)
    assert found == ordinary


@pytest.fixture(scope="module")
def locales(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a locale that writes 0,5 and counts in another alphabet's encoding."""
    folder, compiler = tmp_path_factory.mktemp("locales"), shutil.which("localedef")
    if compiler is None:
        pytest.skip("there is no localedef to make a locale with")
    made = subprocess.run(
        [compiler, "-i", "de_DE", "-f", "ISO-8859-1", str(folder / "de_DE")], capture_output=True
    )
    if not (folder / "de_DE").is_dir():
        pytest.skip(f"localedef cannot make de_DE: {made.stderr.decode(errors='replace')[:200]}")
    return folder


PROGRAMS: dict[str, tuple[list[str], dict[str, str]]] = {
    "LC_ALL=C": (["-OO"], {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}),
    "LC_ALL=de_DE": (
        ["-X", "dev", "-X", "warn_default_encoding"],
        {"LC_ALL": "de_DE", "PYTHONUTF8": "0"},
    ),
}
"""Options and environment of an interpreter; -OO leaves out what -O does, and docstrings."""


@pytest.mark.parametrize("name", [pytest.param("LC_ALL=C", marks=pytest.mark.slow), "LC_ALL=de_DE"])
def test_options_of_the_interpreter_change_no_bit(
    deep: Path, tmp_path: Path, ordinary: str, name: str, request: pytest.FixtureRequest
) -> None:
    """Oracle: as above, in a separate process in which every warning is an error."""
    options, variables = PROGRAMS[name]
    environment = {**os.environ, **variables, "PYTHONPATH": str(ROOT)}
    if "de_DE" in name:
        environment["LOCPATH"] = str(request.getfixturevalue("locales"))
    done = subprocess.run(
        [sys.executable, *options, "-m", "tests.trainer.small_work", str(deep), str(tmp_path)],
        capture_output=True,
        env=environment,
        cwd=ROOT,
        check=False,
    )
    assert done.returncode == 0, done.stderr.decode(errors="replace")[-3000:]
    assert done.stdout.decode().split()[-1] == ordinary
    assert b"Exception ignored" not in done.stderr, done.stderr.decode(errors="replace")
