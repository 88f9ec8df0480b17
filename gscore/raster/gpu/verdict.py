"""Verdict of a device's self-test, kept in the user's cache folder until device, driver, library or
system change."""

import contextlib
import hashlib
import json
import os
import platform
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..._version import __version__
from ...errors import GsError
from ...io.files import atomic_write
from ...json_text import parse_json
from .library import library_hash


@dataclass(frozen=True, kw_only=True)
class DeviceVerdict:
    """Result of the self-test of a device."""

    passed: bool
    problems: tuple[str, ...] = ()
    """Failures, as sentences."""
    figures: Mapping[str, Any] = field(default_factory=dict)
    """Measured errors and times by name, as JSON values."""
    lasting: bool = True
    """Whether a repetition would give the same result; False: the test could not be run, such as
    for lack of memory or time."""

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {
            "passed": self.passed,
            "problems": list(self.problems),
            "figures": dict(self.figures),
        }


def verdict_key(*, uuid: str, driver: str, driver_version: int, subgroup: int) -> dict[str, Any]:
    """All that a verdict depends on, as JSON values."""
    return {
        "uuid": uuid,
        "driver": driver,
        "driver_version": driver_version,
        "subgroup": subgroup,
        "library": library_hash(),
        "system": f"{platform.system()} {platform.release()}",
    }


def read_verdict(key: Mapping[str, Any]) -> DeviceVerdict | None:
    """The verdict for this key; None if there is none, or its file is damaged."""
    name = _file_name(key)
    if name in _of_process:
        return _of_process[name]
    try:
        content = parse_json((cache_folder() / name).read_bytes())
        if content["key"] != dict(key):
            return None
        return _parsed(content["verdict"])
    except (OSError, RuntimeError, ValueError, KeyError, TypeError):
        return None


def _parsed(content: Mapping[str, Any]) -> DeviceVerdict:
    """A verdict from JSON; TypeError or KeyError for other content."""
    if not isinstance(content["passed"], bool):
        raise TypeError("passed is not a truth value")
    problems = tuple(str(problem) for problem in content["problems"])
    return DeviceVerdict(
        passed=content["passed"], problems=problems, figures=dict(content["figures"])
    )


def keep_verdict(key: Mapping[str, Any], verdict: DeviceVerdict, *, in_files: bool = True) -> None:
    """Keep a verdict for this process and with `in_files`, if it lasts and its folder can be
    written, for later ones."""
    name = _file_name(key)
    _of_process[name] = verdict
    if not in_files:
        return
    if not verdict.lasting:
        with contextlib.suppress(OSError, RuntimeError):
            (cache_folder() / name).unlink(missing_ok=True)
        return
    content = {"gscore": __version__, "key": dict(key), "verdict": verdict.to_dict()}
    with contextlib.suppress(GsError, RuntimeError):
        atomic_write(cache_folder() / name, json.dumps(content, indent=1).encode())


_of_process: dict[str, DeviceVerdict] = {}
"""Verdicts of this process by file name, for machines without a cache folder."""


def _file_name(key: Mapping[str, Any]) -> str:
    text = json.dumps(dict(key), sort_keys=True)
    return f"{hashlib.sha256(text.encode()).hexdigest()[:24]}.json"


def cache_folder() -> Path:
    """Folder of the verdicts: `gscore/gpu` in the user's cache folder.

    Raises:
        RuntimeError: the home folder is unknown.
    """
    if sys.platform == "win32" and (local := os.environ.get("LOCALAPPDATA")):
        return Path(local, "gscore", "cache", "gpu")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "gscore" / "gpu"
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    # The XDG base directory specification ignores relative paths.
    return (base if base.is_absolute() else Path.home() / ".cache") / "gscore" / "gpu"
