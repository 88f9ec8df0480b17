"""metrics.json keeps its keys, their order and its values."""

import json
from pathlib import Path
from typing import Any

import pytest

from gscore.events import Decision
from gscore.io.metrics_file import metrics_problem, read_metrics
from gscore.metrics import Course, Evaluation, Metrics, summary
from gscore.report import Report
from gscore.report.page import report_html

FOLDER = Path(__file__).parent / "written_before"
STORED: dict[str, Any] = json.loads((FOLDER / "metrics.json").read_text())
MEANS = list(STORED)[: list(STORED).index("splats")]
MACHINE = {"isa", "threads"}
"""The environment of the rasterizer; the rest depends on the machine."""


def _metrics(monkeypatch: pytest.MonkeyPatch) -> Metrics:
    """The source of the file."""
    rest = {key: value for key, value in STORED["machine"].items() if key not in MACHINE}
    monkeypatch.setattr(summary, "machine", lambda: rest)
    monkeypatch.setattr(summary, "__version__", STORED["gscore"])
    names = ("split", "train_views", "test_views", "mask_mode", "background")
    model = ("splats", "sh_degree", "storage_bytes")
    return Metrics(
        evaluation=Evaluation({key: STORED[key] for key in MEANS}, STORED["views"]),
        course=Course.of_file(read_metrics(FOLDER)),
        **{key: STORED["machine"][key] for key in MACHINE},
        **{key: STORED[key] for key in (*names, *model)},
    )


def test_the_content_is_what_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: a file written before the content had a type, byte for byte."""
    content = _metrics(monkeypatch).content()
    assert json.dumps(content, indent=1) == json.dumps(STORED, indent=1)


def test_a_file_written_before_is_read_whole() -> None:
    """Oracle: the whole file, and a page made from it."""
    assert metrics_problem(FOLDER) == "" and read_metrics(FOLDER) == STORED
    page = report_html(Report(title="x", metrics=read_metrics(FOLDER)))
    assert "24.50" in page and "10 steps" in page


@pytest.mark.parametrize("listed", [True, False])
def test_decisions_of_either_version_are_read(listed: bool) -> None:
    """Oracle: a list with topics; texts alone, whose topic is that of the part with this reason."""
    texts = {"enough" if listed else "": "Fewer steps.", "poses": "Cameras moved."}
    stored: dict[str, Any] = {"decided": list(texts.values())}
    stored["poses"] = {"why": "Cameras moved.", "cameras": {}}
    if listed:
        stored["decisions"] = [{"topic": topic, "text": text} for topic, text in texts.items()]
    course = Course.of_file(STORED | stored)
    assert list(course.decisions) == [Decision(topic, text) for topic, text in texts.items()]


def test_values_that_are_not_finite_are_null(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: strict JSON, which has no NaN; other numbers stay."""
    rows = [{"step": 1, "loss": float("inf"), "psnr": float("nan"), "phase": "training"}]
    metrics = Metrics(**{**vars(_metrics(monkeypatch)), "course": Course(history=rows)})
    (row,) = metrics.content()["history"]
    assert row == {"step": 1, "loss": None, "psnr": None, "phase": "training"}
