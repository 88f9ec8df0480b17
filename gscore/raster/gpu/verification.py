"""Verification of a device: its self-test in a child process, which a driver may crash or hang."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ...errors import Cancelled
from ...json_text import parse_json
from .devices import Device
from .verdict import DeviceVerdict, keep_verdict

Report = Callable[[str], None]
"""Receives a sentence on the progress."""
SECONDS = 60.0
"""Time limit of a self-test."""
_MODULE = "gscore.raster.gpu.self_test"
_KILLED = (1, 2, 9, 15)
"""Signals that come from outside: SIGHUP, SIGINT, SIGKILL, SIGTERM."""
_PERIOD = 0.05
"""Seconds between two checks of the child."""


def verified(
    device: Device,
    *,
    report: Report | None = None,
    cancel: Callable[[], bool] | None = None,
    again: bool = False,
    seconds: float = SECONDS,
) -> DeviceVerdict:
    """The verdict of a device: the kept one, or that of a new self-test.

    Args:
        device: A device that lacks nothing.
        report: Receives sentences while the test runs.
        cancel: Returns whether the test is to stop.
        again: Test even if there is a verdict.
        seconds: Time limit.

    Raises:
        Cancelled: `cancel` returned True.
    """
    if not again and (found := device.verdict) is not None:
        return found
    verdict = _tested(device, report or (lambda _: None), cancel, seconds)
    # Injected faults are none of the device, so later programs test it again.
    keep_verdict(device.key, verdict, in_files=not os.environ.get("GSCORE_GPU_FAULT"))
    return verdict


def distrust(device: Device, problem: str) -> None:
    """Let this process use a device no longer, and later ones test it again, because it computed
    wrong results; `problem`: a sentence."""
    verdict = DeviceVerdict(passed=False, problems=(problem,), lasting=False)
    keep_verdict(device.key, verdict, in_files=not os.environ.get("GSCORE_GPU_FAULT"))


def _tested(
    device: Device, report: Report, cancel: Callable[[], bool] | None, seconds: float
) -> DeviceVerdict:
    what = f"Testing {device.name} once, at most {seconds:.0f} s"
    report(what)
    program = [python_program(), "-P", "-m", _MODULE]
    command = [*program, str(device.number), device.uuid, str(seconds)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with tempfile.TemporaryDirectory(prefix="gscore-", ignore_cleanup_errors=True) as folder:
        out, errors = Path(folder, "out"), Path(folder, "errors")
        with out.open("wb") as stdout, errors.open("wb") as stderr:
            try:
                child = subprocess.Popen(
                    command, stdin=subprocess.PIPE, stdout=stdout, stderr=stderr, env=environment
                )
            except OSError as error:
                return _failed(f"the process of the test cannot be started: {error}")
        try:
            code = _wait(child, seconds, cancel, lambda: report(f"{what}: {_doing(out)}"))
        finally:
            _end(child)
        return _verdict(code, seconds, out, errors)


def _wait(
    child: subprocess.Popen[bytes],
    seconds: float,
    cancel: Callable[[], bool] | None,
    show: Callable[[], None],
) -> int | None:
    """The exit code of the child; None: it took too long."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if cancel is not None and cancel():
            raise Cancelled("The test of the graphics card was cancelled.")
        try:
            return child.wait(_PERIOD)
        except subprocess.TimeoutExpired:
            show()
    return None


def _end(child: subprocess.Popen[bytes]) -> None:
    """Kill the child unless it has ended; one stuck in a driver is left to the system."""
    if child.stdin is not None:
        child.stdin.close()
    if child.poll() is None:
        child.kill()
        try:
            child.wait(5.0)
        except subprocess.TimeoutExpired:
            return


def _verdict(code: int | None, seconds: float, out: Path, errors: Path) -> DeviceVerdict:
    last = _doing(out)
    where = f" during: {last}" if last else ""
    if code is None:
        return _failed(f"it took longer than {seconds:.0f} s{where}")
    result = next((m for m in reversed(_messages(out)) if "passed" in m), None)
    if code == 0 and result is not None:
        problems = tuple(str(problem) for problem in result.get("problems", []))
        figures = dict(result.get("figures", {}))
        return DeviceVerdict(
            passed=bool(result["passed"]),
            problems=problems,
            figures=figures,
            lasting=bool(result.get("lasting", True)),
        )
    if code < 0:
        crashed = f"the driver crashed with signal {-code}{where}"
        # The system kills processes too: for lack of memory, or at its shutdown.
        return _failed(crashed, lasting=-code not in _KILLED)
    lines = errors.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    why = f" ({lines[-1][:200]})" if lines else ""
    return _failed(f"its process ended with code {code}{where}{why}")


def _failed(problem: str, *, lasting: bool = False) -> DeviceVerdict:
    return DeviceVerdict(passed=False, problems=(problem,), lasting=lasting)


def _messages(out: Path) -> list[dict[str, Any]]:
    """The JSON objects that the child has written so far, without the output of drivers."""
    found = []
    for line in out.read_bytes().splitlines(keepends=True):
        if line.startswith(b"{") and line.endswith(b"\n"):
            try:
                message = parse_json(line)
            except ValueError:
                continue
            if isinstance(message, dict):
                found.append(message)
    return found


def _doing(out: Path) -> str:
    """The last test that the child has begun."""
    return next((str(m["doing"]) for m in reversed(_messages(out)) if "doing" in m), "starting")


def python_program() -> str:
    """The Python of this process; inside Blender the one that it brings."""
    base = getattr(sys, "_base_executable", "")
    for program in (sys.executable, base, str(Path(sys.prefix, "bin", "python3"))):
        if program and "python" in Path(program).name.lower() and Path(program).is_file():
            return program
    return sys.executable
