"""Stress runner: runs cases, for each instruction set if relevant, and collects their errors."""

import importlib.util
import math
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

from ..errors import ConfigError
from ..raster import native_library
from ..raster.gpu.choice import CPU, Chosen
from .case import CASES, Case, Measure, UnsupportedMachineError
from .compare import merge
from .native import ONLY_CPU, with_device, with_isa


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One row of the table."""

    test: str
    isa: str
    """Instruction set, or name of the graphics card; empty if it does not matter."""
    error: float
    tolerance: float
    passed: bool | None
    """Result; None: skipped."""
    note: str
    seconds: float
    """Time of the whole case, s."""

    def to_dict(self) -> dict[str, Any]:
        """JSON values; numbers that are not finite become null."""
        return {
            "test": self.test,
            "isa": self.isa,
            "error": self.error if math.isfinite(self.error) else None,
            "tolerance": self.tolerance if math.isfinite(self.tolerance) else None,
            "passed": self.passed,
            "note": self.note,
        }


def select(only: Sequence[str] = (), *, full: bool = False) -> list[Case]:
    """Cases whose name contains one of `only`, in order; slow ones if `full` or named by key.

    Raises:
        ConfigError: a word of `only` matches no case.
    """
    from . import chain, depth, files, optimizer, pictures, sizes, threads, training  # noqa: F401

    CASES.sort(key=lambda c: c.name)
    for word in only:
        if not any(word.lower() in c.name.lower() for c in CASES):
            names = "; ".join(c.name for c in CASES)
            raise ConfigError(f"`--only {word}`: no test name contains this. Tests: {names}.")
    keys = {word.lower() for word in only}
    return [
        c
        for c in CASES
        if (not only or any(word in c.name.lower() for word in keys))
        and (full or not c.slow or c.key.lower() in keys)
    ]


def run_cases(
    cases: Sequence[Case],
    *,
    isas: Sequence[str] = (),
    device: Chosen = CPU,
    full: bool = False,
    report: Callable[[Outcome], None] = lambda _: None,
) -> list[Outcome]:
    """Run cases with each of `isas` (default: the current one), or on a graphics card, and report
    each outcome."""
    found = []
    names = [device.identity] if device.device else isas or [native_library.isa()]
    for one in cases:
        for name in names if one.per_isa or device.device else [""]:
            for outcome in _outcomes(one, name, device, full):
                found.append(outcome)
                report(outcome)
    return found


def _outcomes(one: Case, isa: str, device: Chosen, full: bool) -> Iterator[Outcome]:
    began = time.perf_counter()

    def outcome(what: str, error: float, tolerance: float, passed: bool | None, note: str):
        return Outcome(
            test=f"{one.name}: {what}" if what else one.name,
            isa=isa,
            error=error,
            tolerance=tolerance,
            passed=passed,
            note=note,
            seconds=time.perf_counter() - began,
        )

    if device.device and not one.on_device:
        yield outcome("", math.nan, math.nan, None, f"skipped: {ONLY_CPU}")
        return
    missing = [name for name in one.needs if importlib.util.find_spec(name) is None]
    if missing:
        yield outcome("", math.nan, math.nan, None, f"skipped: needs {', '.join(missing)}")
        return
    measures: list[Measure] = []
    stopped = ""
    on_cpu = native_library.isa() if device.device or not isa else isa
    try:
        with with_isa(on_cpu), with_device(device), _quiet_torch():
            measures.extend(one.run(full))  # those before an error are kept
    except UnsupportedMachineError as reason:
        stopped = f"skipped: {reason}"
    except Exception as error:  # an error of one case must not hide the others
        where = traceback.extract_tb(error.__traceback__)[-1]
        note = f"{type(error).__name__}: {error} ({where.name}, line {where.lineno})"
        yield outcome("", math.nan, math.nan, False, note)
        return
    if not measures and not stopped:
        yield outcome("", math.nan, math.nan, False, "no measurement")
    for m in merge(measures):
        if m.skipped:
            yield outcome(m.what, math.nan, math.nan, None, f"skipped: {m.note}")
            continue
        error, tolerance = float(m.error), float(m.tolerance)
        yield outcome(m.what, error, tolerance, error <= tolerance, m.note)
    if stopped:
        yield outcome("", math.nan, math.nan, None, stopped)


def _quiet_torch() -> AbstractContextManager[None]:
    """Context with one torch thread, if torch is installed: tensors are small here, and several
    threads take minutes for seconds of work on a busy machine."""
    if importlib.util.find_spec("torch") is None:
        return nullcontext()
    from ..trainer.host.isolated_state import isolated_torch_state

    return isolated_torch_state()
