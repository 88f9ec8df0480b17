"""Memory of the system: all of it, and what is available. Standard library only."""

import os
import sys
from pathlib import Path

from .cgroup import memory_groups


def total_memory_bytes() -> int | None:
    """Physical memory, or the limit of the container if that is less; None if unknown."""
    if sys.platform == "linux":
        total = proc_bytes(Path("/proc/meminfo"), "MemTotal")
        groups = memory_groups()
        return min([total, *(group.limit for group in groups)]) if total else total
    if sys.platform == "win32":
        return _windows_memory()[0]
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def available_memory_bytes() -> int | None:
    """Memory that a new program could use without swapping, or None if unknown."""
    if sys.platform == "linux":
        free = proc_bytes(Path("/proc/meminfo"), "MemAvailable")
        groups = memory_groups()
        return max(0, min([free, *(group.free for group in groups)])) if free else free
    if sys.platform == "win32":
        return _windows_memory()[1]
    return None


def proc_bytes(path: Path, key: str) -> int | None:
    """Value of a line `key:  123 kB` in a /proc file, bytes."""
    try:
        lines = path.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return None
    for line in lines:
        name, _, value = line.partition(":")
        if name == key:
            return int(value.split()[0]) * 1024
    return None


def _windows_memory() -> tuple[int | None, int | None]:
    """Physical and available memory from GlobalMemoryStatusEx."""
    import ctypes

    # MEMORYSTATUSEX of sysinfoapi.h: its size and the load, 4 bytes each; then numbers of 8 bytes.
    status = (ctypes.c_uint64 * 8)(64)
    if not ctypes.WinDLL("kernel32").GlobalMemoryStatusEx(status):  # type: ignore[attr-defined]
        return None, None
    return status[1], status[2]
