"""Verdicts of devices: kept, renewed, and made in a child process."""

import subprocess
import sys
from pathlib import Path

import pytest

from gscore.errors import Cancelled
from gscore.raster.gpu import verdict as module
from gscore.raster.gpu import verification
from gscore.raster.gpu.devices import Device, find_devices
from gscore.raster.gpu.verdict import DeviceVerdict, keep_verdict, read_verdict, verdict_key
from gscore.raster.gpu.verification import distrust, verified
from tests.gpu.drivers import ROOT
from tests.gpu.fake_gpu import card

KEY = {"uuid": "00", "driver": "d", "driver_version": 1, "subgroup": 32, "library": "a"}
PASSED = DeviceVerdict(passed=True, figures={"exp2_error": 2e-7})


@pytest.fixture
def other_process(monkeypatch: pytest.MonkeyPatch):
    """Forget what this process remembers."""
    return lambda: monkeypatch.setattr(module, "_of_process", {})


def test_a_verdict_is_kept(other_process) -> None:
    """Oracle: the one that was kept, also for a later process."""
    assert read_verdict(KEY) is None
    keep_verdict(KEY, PASSED)
    other_process()
    assert read_verdict(KEY) == PASSED


@pytest.mark.parametrize("field", KEY)
def test_a_verdict_ends_with_its_key(field: str) -> None:
    """Oracle: none for another device, driver or library."""
    keep_verdict(KEY, PASSED)
    assert read_verdict(KEY | {field: "other"}) is None


def test_the_key_has_library_and_system(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: a library with other bytes."""
    facts = {"uuid": "00", "driver": "d", "driver_version": 1, "subgroup": 32}
    monkeypatch.setattr(module, "library_hash", lambda: "a")
    first = verdict_key(**facts)
    monkeypatch.setattr(module, "library_hash", lambda: "b")
    assert first != verdict_key(**facts) and first["system"]


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "null", '{"key": 1}', '{"key": {}, "verdict": {"passed": 1}}']
)
def test_damaged_files_are_no_verdict(cache: Path, other_process, text: str) -> None:
    """Oracle: none, so that the test is repeated."""
    keep_verdict(KEY, PASSED)
    other_process()
    (path,) = cache.glob("*.json")
    path.write_text(text)
    assert read_verdict(KEY) is None


def test_without_a_cache_folder_it_lasts_for_the_process(
    monkeypatch: pytest.MonkeyPatch, other_process, tmp_path: Path
) -> None:
    """Oracle: a file where the folder would be."""
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(module, "cache_folder", lambda: tmp_path / "file" / "gpu")
    keep_verdict(KEY, PASSED)
    assert read_verdict(KEY) == PASSED
    other_process()
    assert read_verdict(KEY) is None


@pytest.fixture
def child(fake, monkeypatch: pytest.MonkeyPatch):
    """A device whose self-test is a child that behaves as named."""
    fake(card())
    monkeypatch.setattr(verification, "_MODULE", "tests.gpu.child")

    def behave(how: str) -> Device:
        monkeypatch.setenv("GSCORE_TEST_CHILD", how)
        return find_devices().devices[0]

    return behave


def test_a_verdict_comes_from_the_child(child) -> None:
    """Oracle: what the child prints, between lines of a driver; asked for again, not repeated."""
    device, sentences = child("passes"), []
    found = verified(device, report=sentences.append)
    assert found.passed and found.figures == {"seconds": 1.5}
    assert sentences[0].startswith("Testing Card once, at most 60 s")
    child("fails")
    assert verified(device).passed
    assert not verified(device, again=True).passed
    assert device.reason.startswith("Its self-test failed: rgb differs.")


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("crashes", "crashed with signal"),
        ("raises", "ended with code 1 during: drawing (ValueError: no)"),
        ("says nothing", "ended with code 0"),
    ],
)
def test_a_child_that_fails_is_a_failed_test(child, how: str, words: str) -> None:
    """Oracle: the way in which it ended, and what it was doing."""
    found = verified(child(how))
    assert not found.passed and words in found.problems[0]


def test_a_child_that_hangs_is_ended(child) -> None:
    """Oracle: the time limit in the sentence; the child waits an hour."""
    found = verified(child("hangs"), seconds=0.2)
    assert not found.passed and found.problems[0].startswith("it took longer than 0 s during: ")


@pytest.mark.parametrize(
    ("how", "kept"),
    [
        ("passes", True),
        ("fails", True),
        ("crashes", True),
        ("is killed", False),
        ("lacks memory", False),
        ("raises", False),
        ("hangs", False),
    ],
)
def test_passing_failures_are_tested_again(child, other_process, how: str, kept: bool) -> None:
    """Oracle: what a later process finds; this one does not repeat the test. An older verdict is
    replaced or removed."""
    device = child(how)
    keep_verdict(device.key, PASSED)
    found = verified(device, again=True, seconds=60.0 if how != "hangs" else 0.2)
    assert found.passed == (how == "passes") and device.verdict == found
    other_process()
    assert (device.verdict is not None) == kept


@pytest.mark.parametrize(("seconds", "closes"), [("0.2", False), ("3600", True)])
def test_a_child_ends_without_its_parent(
    monkeypatch: pytest.MonkeyPatch, seconds: str, closes: bool
) -> None:
    """Oracle: the exit code of a child that hangs: its own timer, or the end of its input."""
    monkeypatch.setenv("GSCORE_TEST_CHILD", "hangs")
    command = [sys.executable, "-m", "tests.gpu.child", "0", "", seconds]
    with subprocess.Popen(
        command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL
    ) as process:
        if closes and process.stdin is not None:
            process.stdin.close()
        assert process.wait(60) == 3


def test_a_cancelled_test_is_no_verdict(child) -> None:
    """Oracle: the error, and no verdict."""
    device = child("hangs")
    with pytest.raises(Cancelled):
        verified(device, cancel=lambda: True)
    assert device.verdict is None


def test_injected_faults_are_for_one_process(
    child, other_process, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the older verdict in a later process, after a test with GSCORE_GPU_FAULT."""
    device = child("fails")
    keep_verdict(device.key, PASSED)
    monkeypatch.setenv("GSCORE_GPU_FAULT", "wrong")
    assert not verified(device, again=True).passed and "rgb differs" in device.reason
    other_process()
    assert device.verdict == PASSED


def test_wrong_results_end_a_verdict(child, other_process) -> None:
    """Oracle: the device failed in this process, and is tested again in a later one."""
    device = child("passes")
    keep_verdict(device.key, PASSED)
    distrust(device, "It is wrong.")
    assert verified(device).problems == ("It is wrong.",)
    other_process()
    assert device.verdict is None


def test_a_python_is_found_in_a_program_without_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the interpreter on which that of a virtual environment is based."""
    monkeypatch.setattr(verification.sys, "executable", "/opt/blender")
    program = Path(verification.python_program())
    assert "python" in program.name and program.is_file()
