"""Peak memory and the description of the machine."""

import subprocess
import sys

import pytest

from gscore.metrics import machine as m


def test_peak_memory_sees_an_allocation_and_not_the_parent():
    """Oracle: a child, started by this larger process, before and after it touches 120 MB."""
    code = (
        "from gscore.metrics.machine import peak_memory_bytes\n"
        "before = peak_memory_bytes()\n"
        "block = bytearray(b'x') * 120_000_000\n"
        "del block\n"
        "print(before, peak_memory_bytes())"
    )
    ballast = bytearray(b"y") * 300_000_000
    output = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    before, after = map(int, output.split())
    assert len(ballast) == 300_000_000
    assert 115e6 < after - before < 200e6
    if sys.platform == "linux":
        assert before < 250e6


def test_memory_is_plausible():
    """Oracle: what is available is part of what there is."""
    total, available = m.total_memory_bytes(), m.available_memory_bytes()
    assert total is not None and total > 2**28
    if available is not None:
        assert 0 < available <= total


def test_container_limits_count(monkeypatch):
    """Oracle: the smaller of machine and container."""
    if sys.platform != "linux":
        pytest.skip("cgroups are Linux's")
    values = {"memory.max": 3_000_000_000, "memory.current": 1_000_000_000}
    monkeypatch.setattr(m, "_cgroup_value", values.get)
    assert m.total_memory_bytes() == 3_000_000_000
    assert 0 < m.available_memory_bytes() <= 2_000_000_000


def test_machine_names_what_ran():
    """Oracle: the interpreter running this test."""
    told = m.machine()
    assert told["python"] == ".".join(map(str, sys.version_info[:3]))
    assert told["cpu"] and told["cores"] >= 1
    assert m.version_of("numpy") and m.version_of("no-such-package-at-all") is None
