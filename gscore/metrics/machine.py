"""Machine record: memory, processor and versions of a run. Standard library only."""

import os
import platform
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

from ..io.system_memory import proc_bytes, total_memory_bytes


def peak_memory_bytes() -> int | None:
    """Peak resident memory of this process, or None if the system does not report it.

    On Linux this is the kernel's high-water mark of this program image, because `ru_maxrss` also
    counts the parent that started it, for example Blender.
    """
    if sys.platform == "linux":
        return proc_bytes(Path("/proc/self/status"), "VmHWM")
    if sys.platform == "win32":
        return _windows_peak()
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024  # macOS counts bytes, BSD kB


def cpu_name() -> str:
    """The processor's model name, if the system provides it."""
    if sys.platform == "linux":
        try:
            lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        except OSError:
            lines = []
        for line in lines:
            key, _, value = line.partition(":")
            if key.strip() == "model name":
                return value.strip()
    if sys.platform == "darwin":
        import subprocess

        command = ["/usr/sbin/sysctl", "-n", "machdep.cpu.brand_string"]
        try:
            found = subprocess.run(command, capture_output=True, text=True, timeout=5, check=True)
        except (OSError, subprocess.SubprocessError):
            return platform.processor() or platform.machine()
        return found.stdout.strip()
    return platform.processor() or platform.machine()


def cores() -> int:
    """Logical processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def version_of(distribution: str) -> str | None:
    """Installed version of a distribution, without importing it; None if it is not installed."""
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def machine() -> dict[str, Any]:
    """Description of the machine for metrics.json; unknown values are None."""
    return {
        "cpu": cpu_name(),
        "cores": cores(),
        "memory_bytes": total_memory_bytes(),
        "platform": platform.platform(terse=True),
        "arch": platform.machine(),
        "python": platform.python_version(),
        "torch": version_of("torch"),
    }


def _windows_peak() -> int | None:
    import ctypes

    # PROCESS_MEMORY_COUNTERS of psapi.h on 64 bits: its size and the page faults in 4 bytes each,
    # then sizes of 8 bytes, the first of which is the peak. -1 is the handle of this process.
    counters = (ctypes.c_uint64 * 9)(72)
    query = ctypes.WinDLL("kernel32").K32GetProcessMemoryInfo  # type: ignore[attr-defined]
    found = query(ctypes.c_void_p(-1), counters, 72)
    return counters[1] if found else None
