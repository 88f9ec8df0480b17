"""The line protocol; oracle: strict JSON and equality after a round trip."""

import json
import math

import pytest

from gscore.events import (
    KINDS,
    TOPICS,
    Decision,
    Done,
    Eval,
    Failed,
    Progress,
    Started,
    Warn,
    from_line,
    to_line,
)

PROGRESS = Progress(
    step=3,
    iterations=10,
    loss=0.25,
    psnr=12.5,
    splats=7,
    steps_per_s=1.5,
    eta_s=4.0,
    elapsed_s=2.0,
    phase="growing",
)


@pytest.mark.parametrize(
    "event",
    [
        PROGRESS,
        Warn(message='line\nbreak "quoted" ü', code="x"),
        Eval(step=1, split="test", metrics={"psnr": 1.0, "lpips": None, "machine": {"cores": 2}}),
        Failed(message="no"),
        Done(step=1, reason="finished", splats=2, train_seconds=0.5, path="a/b.ply"),
    ],
)
def test_a_line_gives_the_event_back(event) -> None:
    """Oracle: equality, in one line."""
    line = to_line(event)
    assert "\n" not in line
    assert json.loads(line)["event"] == event.kind
    assert from_line(line) == event


def test_numbers_that_json_lacks_become_null() -> None:
    """Oracle: a strict parser."""
    event = Eval(step=1, split="test", metrics={"a": math.inf, "b": [math.nan, {"c": -math.inf}]})

    def refuse(word: str) -> None:
        pytest.fail(f"{word} is not JSON")

    data = json.loads(to_line(event), parse_constant=refuse)
    assert data["metrics"] == {"a": None, "b": [None, {"c": None}]}


@pytest.mark.parametrize(
    "line",
    ["", "hello", "{", "[]", "3", '{"event": "dance"}', '{"event": "progress", "step": 1}', "{}"],
)
def test_lines_of_other_programs_are_no_events(line: str) -> None:
    """Oracle: None instead of an error."""
    assert from_line(line) is None


def test_fields_of_later_versions_are_skipped() -> None:
    """Oracle: the event without them."""
    data = json.loads(to_line(PROGRESS)) | {"mood": "good"}
    assert from_line(json.dumps(data)) == PROGRESS


DECISIONS = [Decision("enough", "Fewer steps."), Decision("depth", "Depth is not used.")]
STARTED = Started(
    source="s",
    output="o",
    iterations=9,
    step=0,
    train_views=7,
    test_views=1,
    splats=10,
    width=4,
    height=3,
    isa="avx2",
    threads=2,
    device="Card",
    left_s=5.0,
    decisions=DECISIONS,
)


def test_decisions_are_read_from_either_kind_of_key() -> None:
    """Oracle: the same decisions, from the list and from the keys by topic of older versions;
    today's events still have those keys."""
    data = json.loads(to_line(STARTED))
    assert data["decisions"][0] == {"topic": "enough", "text": "Fewer steps."}
    assert (data["enough"], data["depth"]) == ("Fewer steps.", "Depth is not used.")
    assert all(data[topic] == "" for topic in TOPICS if topic not in ("enough", "depth"))
    assert from_line(json.dumps(data)) == STARTED
    del data["decisions"]
    assert from_line(json.dumps(data)) == STARTED
    assert (STARTED.decision("depth"), STARTED.decision("poses")) == ("Depth is not used.", "")


@pytest.mark.parametrize("value", [3, None, [3], ["topic"], [{"topic": "depth"}], {"depth": "no"}])
def test_damaged_decisions_are_no_event(value) -> None:
    """Oracle: None, as for any other damaged line."""
    assert from_line(json.dumps(json.loads(to_line(STARTED)) | {"decisions": value})) is None


def test_kinds_are_those_of_the_protocol() -> None:
    """Oracle: the kinds in the protocol."""
    words = "estimate started progress preview snapshot eval warning saved done error"
    words += " sequence frame depth depth_progress evaluated eval_progress"
    words += " sfm sfm_estimate sfm_progress frames frames_progress refit refit_progress"
    words += " mesh mesh_plan mesh_progress"
    assert set(KINDS) == set(words.split())
    assert KINDS["started"] is Started
