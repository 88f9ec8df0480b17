"""Cgroup memory limits of this process: Linux containers and services."""

from dataclasses import dataclass
from pathlib import Path, PurePosixPath

_FILES = {
    2: ("memory.max", "memory.current", "inactive_file"),
    1: ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
}
"""By version: the limit, what is used, and the line of memory.stat that says how much of that are
files which the kernel drops when memory is asked for."""
_NO_LIMIT = 1 << 60
"""Version 1 writes a number near 2^63 where there is none."""


@dataclass(frozen=True, kw_only=True)
class MemoryGroup:
    """A group that limits memory."""

    limit: int
    """Bytes."""
    free: int
    """Bytes that may still be taken; below 0 where the limit was lowered."""


def memory_groups(
    listing: Path = Path("/proc/self/cgroup"), mounted: Path = Path("/sys/fs/cgroup")
) -> list[MemoryGroup]:
    """The groups of this process and those around them that have a limit, innermost first.

    Args:
        listing: What the kernel lists the process's groups in, see cgroups(7).
        mounted: Where the control groups are mounted.
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
        # Inside a container the place may be named as the host sees it; its root is then ours.
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
