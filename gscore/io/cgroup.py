"""Cgroup memory limits of this process: Linux containers and services."""

from dataclasses import dataclass
from pathlib import Path, PurePosixPath

_FILES = {
    2: ("memory.max", "memory.current", "inactive_file"),
    1: ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
}
"""By cgroup version: files of the limit and the usage, and the line of memory.stat with the
reclaimable file cache."""
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
