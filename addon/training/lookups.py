"""Lookups of folders and installed networks for panels: read in threads and cached; no bpy.

Messages of gscore are translated to panel labels here, so callers show and raise them unchanged.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..capture.depth_maps import DepthReport, read_run_report
from ..capture.figures import Figures, measured
from ..capture.inspection import ShownFacts, inspect
from ..core import (
    DataConfig,
    Estimate,
    SequenceFrame,
    SequenceIndex,
    find_frames,
    read_sequence,
)
from ..interface.lookup import Lookup
from ..interface.option_labels import panel_text
from ..process.child_program import Process
from . import existing_run, forecast

_TIMEOUT = 60.0
"""Seconds for an answer from a cold disk."""


def networks_here(python: str) -> frozenset[str]:
    """Names of the installed networks; for a thread.

    Raises:
        ValueError: the Python gave no answer.
    """
    problem = f"{python} cannot list depth networks; press Check in the add-on's preferences."
    try:
        process = Process([python, "-m", "gscore", "depth", "--list-models", "--json"])
        output = process.output(timeout=_TIMEOUT)
    except OSError as error:
        raise ValueError(problem) from error
    for line in reversed(output):
        if (names := _names(line)) is not None:
            return names
    raise ValueError(problem)


def _names(line: str) -> frozenset[str] | None:
    try:
        rows: Any = json.loads(line)["models"]
        return frozenset(str(row["name"]) for row in rows if row["file"])
    except (ValueError, KeyError, TypeError):
        return None


def _inspected(key: tuple[str, str]) -> ShownFacts:
    facts = inspect(key[0], images=key[1])
    problems = (replace(one, text=panel_text(one.text)) for one in facts.problems)
    return replace(facts, problems=tuple(problems))


def _report(output: Path) -> DepthReport | None:
    report = read_run_report(output)
    return None if report is None else replace(report, why=panel_text(report.why))


captures: Lookup[tuple[str, str], ShownFacts] = Lookup(_inspected, max_age=600.0)
"""Facts of captures, by path and name of the photo folder."""
runs: Lookup[tuple[Path, Path | None], existing_run.EarlierRun | None] = Lookup(
    lambda key: existing_run.read_existing_run(*key), max_age=3.0
)
"""Existing runs, by output folder and path of the chosen capture."""
depth_runs: Lookup[Path, DepthReport | None] = Lookup(_report, max_age=10.0)
"""Depth reports of runs, by output folder."""
figures: Lookup[Path, Figures | None] = Lookup(measured, max_age=10.0)
"""Measured errors of runs on all photos, by output folder."""
forecasts: Lookup[forecast.Question, Estimate] = Lookup(forecast.answer, max_age=20.0)
"""Forecasts of time and memory."""
networks: Lookup[str, frozenset[str]] = Lookup(networks_here, max_age=300.0)
"""Names of the depth networks on this computer, by the Python that predicts."""
frames: Lookup[tuple[str, str], list[SequenceFrame]] = Lookup(
    lambda key: find_frames(DataConfig(source=Path(key[0]), images=key[1])), max_age=60.0
)
"""Frames of sequences, by path of the capture and name of its photo folder."""
sequences: Lookup[Path, SequenceIndex | None] = Lookup(read_sequence, max_age=3.0)
"""Trained sequences, by output folder."""
_ALL = (captures, runs, depth_runs, figures, forecasts, networks, frames, sequences)


def collect() -> bool:
    """Collect finished lookups; True if there were any."""
    return sum(lookup.collect() for lookup in _ALL) > 0  # any() would stop at the first


def busy() -> bool:
    """True while a lookup is running."""
    return any(lookup.busy for lookup in _ALL)
