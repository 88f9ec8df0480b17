"""JSON files of gscore, damaged by hand; oracle: code 0 or 2 and sentences, no traceback."""

import json
from dataclasses import asdict

import pytest

from gscore.io.metrics_file import metrics_problem, read_metrics
from gscore.io.runs import read_run
from gscore.io.sequences import SequenceIndex, write_sequence
from gscore.text_format import trust_text, worst_view_text
from gscore.trainer.sequence import SequenceOptions

ODD = (
    "NaN",
    "-Infinity",
    "1e999",
    "1" + "0" * 400,
    "true",
    '"high"',
    '"\\ud800"',
    "[]",
    "[[1], null]",
    '[{"step": "x"}]',
    "{}",
    '{"views": [1]}',
    "null",
)
WHOLE = ("", "{", "[]", "3", "null", '"text"', "[" * 100_000, '{"psnr":' * 100_000, "\xff", "NaN")


def _assert_said(result, code=(0, 2)):
    found, out, err = result
    assert found in code, err
    assert "Traceback" not in err + out
    return out, err


@pytest.fixture(scope="module")
def kept():
    """The metrics.json of an evaluation, by the first test that needs one."""
    return {}


@pytest.fixture
def measured(gscore, run_folder, kept):
    """A run with all keys of a metrics.json."""
    folder = run_folder()
    path = folder / "metrics.json"
    before = json.loads(path.read_text())
    if not kept:
        assert gscore("eval", folder, "--quiet")[0] == 0
        kept.update(json.loads(path.read_text()))
    moved = {"why": "They missed.", "cameras": {"a.png": {"degrees": 0.5, "extents": 0.01}}}
    full = kept | {
        "psnr_masked": 20.0,
        "reason": "finished",
        "depth": {},
        "poses": moved,
        "blurs": {"a.png": 2.5},
        "decisions": [{"topic": "poses", "text": "They missed."}],
    }
    assert before.keys() <= full.keys()
    return folder, full


@pytest.mark.parametrize("value", ODD)
def test_a_metrics_json_with_an_odd_value_is_a_sentence(gscore, measured, value):
    """Oracle: every key in turn; verbs that list runs read the rest and name the invalid key."""
    folder, full = measured
    reported = 0
    for key in full:
        text = json.dumps(full | {key: "@"}).replace('"@"', value)
        (folder / "metrics.json").write_text(text)
        out, _ = _assert_said(gscore("info", folder), (0,))
        _assert_said(gscore("info", folder, "--json"), (0,))
        assert read_run(folder) is not None
        reported += f"metrics.json is damaged: {key} cannot be; `gscore eval" in out
        assert key not in read_metrics(folder) or not metrics_problem(folder)
    assert reported >= (0 if value == "null" else 8)


@pytest.mark.parametrize("content", WHOLE)
def test_a_metrics_json_that_is_none_is_a_sentence(gscore, measured, content, tmp_path):
    """Oracle: its readers, and a new measurement, which replaces it."""
    folder, _ = measured
    (folder / "metrics.json").write_bytes(content.encode("latin-1"))
    out, _ = _assert_said(gscore("info", folder), (0,))
    assert "metrics.json is damaged" in out
    _assert_said(gscore("render", folder, "--test", "-o", tmp_path / "r"), (2,))
    _, err = _assert_said(gscore("eval", folder), (0,))
    assert "metrics.json is damaged" in err
    assert metrics_problem(folder) == ""


@pytest.mark.parametrize("value", ODD)
def test_a_metrics_json_with_odd_values_goes_through_all_verbs(gscore, measured, value, tmp_path):
    """Oracle: all values invalid at the same time."""
    folder, full = measured
    text = json.dumps(dict.fromkeys(full, "@")).replace('"@"', value)
    for arguments in (
        ("render", folder, "--test", "-o", tmp_path / "r", "-r", "8"),
        ("train", "-o", folder, "--resume", "--quiet"),
        ("train", "-o", folder, "--overwrite", "--quiet"),
        ("eval", folder, "--quiet"),
    ):
        (folder / "metrics.json").write_text(text)
        _assert_said(gscore(*arguments))


@pytest.mark.parametrize("value", [*ODD, '{"trust": 1}', '{"between": ["a"], "trust": 1}'])
def test_figures_of_views_may_be_odd(measured, value):
    """Oracle: an odd value is dropped, the sentences state what is left."""
    folder, full = measured
    known = {"between": ["a", "b"], "trust": 0.5}
    full = full | {"trust_lowest": known, "trust_median": 0.7, "not_covered": ["a"]}
    for key in ("trust_lowest", "trust_median", "worst_view", "not_covered"):
        (folder / "metrics.json").write_text(json.dumps(full | {key: "@"}).replace('"@"', value))
        found = read_metrics(folder)
        assert isinstance(trust_text(found) + worst_view_text(found), str)


@pytest.mark.parametrize("part", ["topic", "text"])
@pytest.mark.parametrize("value", ODD)
def test_decisions_may_be_odd(gscore, measured, value, part):
    """Oracle: only a text is read; a new measurement, which needs none of them."""
    folder, full = measured
    odd = full["decisions"][0] | {part: "@"}
    (folder / "metrics.json").write_text(
        json.dumps(full | {"decisions": [odd]}).replace('"@"', value)
    )
    assert (read_metrics(folder).get("decisions") is not None) == value.startswith('"')
    _assert_said(gscore("eval", folder, "--quiet"), (0,))


@pytest.mark.parametrize("key", ["exposure", "poses", "blurs"])
def test_parts_of_what_a_training_found_may_be_odd(gscore, measured, key):
    """Oracle: its parts, one after the other; a new measurement does not need them."""
    folder, full = measured
    assert full[key], "nothing to break"
    for part in full[key]:
        for value in ODD:
            text = json.dumps(full | {key: full[key] | {part: "@"}}).replace('"@"', value)
            (folder / "metrics.json").write_text(text)
            assert read_metrics(folder).get(key) is None or not metrics_problem(folder)
        _assert_said(gscore("eval", folder, "--quiet"), (0,))


@pytest.mark.parametrize("value", [*ODD, "-1", "5"])
def test_a_config_json_with_an_odd_value_is_a_sentence(gscore, run_folder, value, tmp_path):
    """Oracle: every option in turn, and both sections."""
    folder = run_folder()
    path = folder / "config.json"
    full = json.loads(path.read_text())
    cases = [(full | {section: "@"}) for section in ("data", "train")]
    for section in ("data", "train"):
        cases += [full | {section: full[section] | {key: "@"}} for key in full[section]]
    for case in cases:
        path.write_text(json.dumps(case).replace('"@"', value))
        _assert_said(gscore("eval", folder, "-o", tmp_path / "e", "--quiet"))


@pytest.mark.parametrize("name", ["config.json", "cameras.json", "sequence.json"])
@pytest.mark.parametrize("content", WHOLE)
def test_files_that_are_none_are_a_sentence(gscore, run_folder, name, content, tmp_path):
    """Oracle: code 2 of the verb that needs the file."""
    folder = run_folder()
    (folder / name).write_bytes(content.encode("latin-1"))
    if name == "sequence.json":
        _assert_said(gscore("info", folder), (2,))
        _assert_said(gscore("sequence", "-o", folder, "--resume"), (2,))
        _assert_said(gscore("sequence", "x", "-o", folder, "--overwrite"), (2,))
    else:
        _assert_said(gscore("render", folder, "-o", tmp_path / "r"), (2,))


@pytest.mark.parametrize("value", ODD)
def test_a_sequence_json_with_an_odd_value_is_a_sentence(gscore, tmp_path, value):
    """Oracle: every key of options, frames and means in turn."""
    frame = {"frame": 0, "folder": "frame_000000", "start": None, "splats": 5, "steps": 3}
    frame |= {"train_seconds": 1.0, "split": "test", "psnr": 20.0, "ssim": 0.5, "lpips": None}
    mean = {"psnr": 20.0, "ssim": 0.5, "train_seconds": 1.0, "frames": 1, "frames_total": 2}
    index = SequenceIndex(options=asdict(SequenceOptions()), frames=[frame], mean=mean)
    write_sequence(tmp_path, index, version="1")
    good = (tmp_path / "sequence.json").read_text()
    assert "1 of 2 frames" in gscore("info", tmp_path)[1]
    for key in (*index.options, *frame, *mean):
        content = json.loads(good)
        for part in (content["options"], content["frames"][0], content["mean"]):
            if key in part:
                part[key] = "@"
        (tmp_path / "sequence.json").write_text(json.dumps(content).replace('"@"', value))
        _assert_said(gscore("info", tmp_path))
        _assert_said(gscore("sequence", "nothing", "-o", tmp_path, "--resume"), (2,))
