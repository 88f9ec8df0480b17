"""Environment of the trainer's Python: search and check; no bpy."""

import json
import os
import shutil
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..process.background_task import BackgroundTask
from ..process.child_program import Process

CHECK_TIMEOUT = 120.0
"""Seconds for `gscore doctor`: loading torch from a cold disk takes a while."""
_NAMES = ("python3", "python", "python3.14", "python3.13", "python3.12", "python3.11")


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Result of a check."""

    python: str
    good: bool
    """Whether it can train."""
    sentence: str
    """Message for the user."""
    facts: Mapping[str, Any]
    """Facts from `gscore doctor`; empty if it did not run."""


def python_in(folder: Path) -> Path:
    """The Python of a virtual environment."""
    return folder / "Scripts" / "python.exe" if os.name == "nt" else folder / "bin" / "python"


def candidates(*, private: Path | None = None) -> list[Path]:
    """Pythons that may have gscore, the most likely first; `private` is the folder of the add-on's
    own environment."""
    return list(dict.fromkeys(path for path in _candidates(private) if path.is_file()))


def chosen_python(text: str) -> Path:
    """The Python of the user's choice: a program, or the folder of a virtual environment."""
    path = Path(text).expanduser()
    return python_in(path) if path.is_dir() else path


def check(python: Path, task: BackgroundTask, *, timeout: float = CHECK_TIMEOUT) -> Verdict:
    """Check by `gscore doctor` whether a Python can train; for a thread.

    Raises:
        Cancelled: the task was cancelled.
    """
    try:
        process = Process([str(python), "-m", "gscore", "doctor", "--json"])
        output = process.output(task.check, timeout=timeout)
    except TimeoutError:
        return _bad(
            python,
            f"{python} did not answer within {timeout:.0f} s; try again, or choose another Python.",
        )
    except OSError as error:
        return _bad(
            python, f"{python} cannot be run ({error.strerror or error}); choose another Python."
        )
    return _verdict(python, output, process.stderr_tail)


def find(task: BackgroundTask, *, chosen: str = "", private: Path | None = None) -> Verdict:
    """The first Python that can train, or the verdict on the most likely one; for a thread.

    With `chosen` only that one is checked.
    """
    if chosen:
        return check(chosen_python(chosen), task)
    verdicts = []
    for python in candidates(private=private):
        task.report(f"Checking {python}")
        verdict = check(python, task)
        if verdict.good:
            return verdict
        verdicts.append(verdict)
    best = next((v for v in verdicts if v.facts), None)
    if best is not None:
        return best
    return Verdict(
        python="",
        good=False,
        sentence="No Python with gscore was found; press Make Environment, or choose one.",
        facts={},
    )


def _candidates(private: Path | None) -> Iterator[Path]:
    if private is not None:
        yield python_in(private)
    if command := shutil.which("gscore"):
        # The command is next to the Python of its environment, or a link to there.
        for folder in (Path(command).resolve().parent, Path(command).parent):
            for name in ("python", "python3"):
                yield folder / (f"{name}.exe" if os.name == "nt" else name)
    for variable in ("VIRTUAL_ENV", "CONDA_PREFIX"):
        if folder := os.environ.get(variable):
            yield python_in(Path(folder))
            yield Path(folder) / "python.exe"
    for name in _NAMES:
        if path := shutil.which(name):
            yield Path(path)
    yield Path(sys.executable)


def _verdict(python: Path, output: list[str], stderr: list[str]) -> Verdict:
    facts = next((f for line in reversed(output) if (f := _facts(line))), None)
    if facts is None:
        last = next((line for line in reversed(stderr) if line.strip()), "without a message")
        return _bad(
            python,
            f"{python} cannot run gscore ({last[:160]}); press Make Environment, or choose another "
            "Python.",
        )
    if facts["can_train"]:
        native, packages = facts.get("native") or {}, facts.get("packages") or {}
        torch = (packages.get("torch") or {}).get("version")
        sentence = (
            f"Ready: gscore {facts.get('gscore')}, Python {facts.get('python')}, torch {torch}, "
            f"{native.get('isa')}, {native.get('threads')} threads."
        )
        return Verdict(python=str(python), good=True, sentence=sentence, facts=facts)
    missing = ", ".join(str(m) for m in facts.get("missing") or ["something"])
    command = facts.get("install") or 'pip install "gscore[train]"'
    return Verdict(
        python=str(python),
        good=False,
        sentence=(
            f"{python} has gscore but cannot train without {missing}; press Make Environment, or "
            f"install there: {command}"
        ),
        facts=facts,
    )


def _bad(python: Path, sentence: str) -> Verdict:
    return Verdict(python=str(python), good=False, sentence=sentence, facts={})


def _facts(line: str) -> dict[str, Any] | None:
    """The JSON object of `gscore doctor --json`; None if the line is anything else."""
    try:
        facts = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return facts if isinstance(facts, dict) and "can_train" in facts else None
