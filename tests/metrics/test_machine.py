"""Peak memory and the description of the machine."""

import subprocess
import sys

import pytest

from gscore.io import system_memory as m
from gscore.io.system_memory import MemoryGroup, memory_groups
from gscore.metrics.machine import machine, version_of


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
    """Oracle: the total memory, which is at least the available part."""
    total, available = m.total_memory_bytes(), m.available_memory_bytes()
    assert total is not None and total > 2**28
    if available is not None:
        assert 0 < available <= total


def test_container_limits_count(monkeypatch):
    """Oracle: the smaller of machine and container."""
    if sys.platform != "linux":
        pytest.skip("cgroups are Linux's")
    group = MemoryGroup(limit=3_000_000_000, free=2_000_000_000)
    monkeypatch.setattr(m, "memory_groups", lambda: [group])
    assert m.total_memory_bytes() == 3_000_000_000
    assert 0 < (m.available_memory_bytes() or 0) <= 2_000_000_000


def write_group(folder, **files):
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name.replace("__", ".")).write_text(f"{text}\n")


def test_groups_around_the_process_count(tmp_path):
    """Oracle: by hand. A service without a limit in a slice with one; cached files are free."""
    listing, root = tmp_path / "cgroup", tmp_path / "fs"
    listing.write_text("0::/work.slice/run.service\n")
    write_group(root, memory__max="max", memory__current=5_000)
    write_group(
        root / "work.slice",
        memory__max=4_000,
        memory__current=3_000,
        memory__stat="anon 1\ninactive_file 500",
    )
    write_group(root / "work.slice" / "run.service", memory__max="max", memory__current=2_000)
    assert memory_groups(listing, root) == [MemoryGroup(limit=4_000, free=1_500)]


def test_groups_of_the_first_version_count(tmp_path):
    """Oracle: by hand; near 2^63 means no limit, and other controllers have no memory limits."""
    listing, root = tmp_path / "cgroup", tmp_path / "fs"
    listing.write_text("4:memory:/docker/abc\n3:cpuset:/x\n1:name=systemd:/\n")
    names = {"memory__limit_in_bytes": 9_000, "memory__usage_in_bytes": 8_000}
    write_group(root / "memory" / "docker" / "abc", **names, memory__stat="total_inactive_file 7")
    write_group(root / "memory", memory__limit_in_bytes=2**63 - 4096, memory__usage_in_bytes=1)
    assert memory_groups(listing, root) == [MemoryGroup(limit=9_000, free=1_007)]
    assert memory_groups(tmp_path / "none", root) == []


def test_machine_names_what_ran():
    """Oracle: the interpreter running this test."""
    reported = machine()
    assert reported["python"] == ".".join(map(str, sys.version_info[:3]))
    assert reported["cpu"] and reported["cores"] >= 1
    assert version_of("numpy") and version_of("no-such-package-at-all") is None
