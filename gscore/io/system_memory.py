"""Memory of the system: all, available, limits by cgroups. Standard library only."""

import os
import sys
from dataclasses import dataclass
from pathlib import Path, PurePosixPath


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


_FILES = {
    2: ("memory.max", "memory.current", "inactive_file"),
    1: ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
}
"""Files of the limit and the usage, and the line of memory.stat with the reclaimable file cache, by
cgroup version."""
_NO_LIMIT = 1 << 60
"""Value from which on there is no limit; version 1 writes a number near 2^63."""


@dataclass(frozen=True, kw_only=True)
class MemoryGroup:
    """A control group with a memory limit."""

    limit: int
    """Bytes."""
    free: int
    """Bytes available; negative if the limit was lowered below the usage."""


def memory_groups(
    listing: Path = Path("/proc/self/cgroup"), mounted: Path = Path("/sys/fs/cgroup")
) -> list[MemoryGroup]:
    """The groups of this process and their parents that have a limit, innermost first.

    Args:
        listing: File with the process's groups, see cgroups(7).
        mounted: Mount point of the control groups.
    """
    try:
        lines = listing.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    found = []
    for line in lines:
        _, controllers, place = [*line.split(":", 2), "", ""][:3]
        version, root = 2, mounted
        if "memory" in controllers.split(","):
            version, root = 1, mounted / "memory"
        elif controllers:
            continue
        # Inside a container the path may be that on the host; the mount is then its root.
        names = [part for part in PurePosixPath(place).parts if part not in ("/", "..")]
        for depth in range(len(names), -1, -1):
            group = _read(root.joinpath(*names[:depth]), version)
            if group is not None:
                found.append(group)
    return found


def _read(folder: Path, version: int) -> MemoryGroup | None:
    limit_name, used_name, dropped_name = _FILES[version]
    limit, used = _number(folder / limit_name), _number(folder / used_name)
    if limit is None or used is None or limit >= _NO_LIMIT:
        return None
    return MemoryGroup(limit=limit, free=limit - used + _stat(folder, dropped_name))


def _number(path: Path) -> int | None:
    try:
        return int(path.read_text(encoding="ascii"))
    except (OSError, ValueError):  # no such file, or the word "max"
        return None


def _stat(folder: Path, name: str) -> int:
    try:
        text = (folder / "memory.stat").read_text(encoding="ascii")
    except (OSError, ValueError):
        return 0
    for line in text.splitlines():
        key, _, value = line.partition(" ")
        if key == name and value.isdigit():
            return int(value)
    return 0
