"""System folders of Linux, macOS and Windows, where no results may be written."""

import os
import re
import sys
from collections.abc import Iterable, Mapping
from pathlib import PurePath, PureWindowsPath

_DEVICES = ("/dev", "/proc", "/sys")
"""Folders of devices and kernel data, except shared memory, which works as a disk."""
_SHARED_MEMORY = "/dev/shm"
_TREES = (
    *("/bin", "/boot", "/cores", "/etc", "/lib", "/lib32", "/lib64", "/libx32", "/sbin"),
    *("/usr/bin", "/usr/include", "/usr/lib", "/usr/lib32", "/usr/lib64", "/usr/libexec"),
    *("/usr/libx32", "/usr/sbin", "/usr/share", "/usr/standalone", "/Library", "/System"),
)
"""Folders of the system, with no user's files below them."""
_SHARED = (
    *(_SHARED_MEMORY, "/home", "/media", "/mnt", "/opt", "/private", "/root", "/run", "/srv"),
    *("/tmp", "/usr", "/usr/home", "/usr/local", "/usr/local/bin", "/usr/local/etc"),
    *("/usr/local/lib", "/usr/local/sbin", "/usr/local/share", "/usr/src", "/var", "/var/cache"),
    *("/var/folders", "/var/home", "/var/lib", "/var/log", "/var/spool", "/var/tmp"),
    *("/Applications", "/Users", "/Users/Shared", "/Volumes"),
)
"""Folders shared by many users and programs: a new folder in them is fine."""
_WINDOWS_TREES = ("SystemRoot", "ProgramFiles", "ProgramFiles(x86)", "ProgramW6432")
_WINDOWS_SHARED = ("ProgramData", "PUBLIC", "TEMP", "TMP", "APPDATA", "LOCALAPPDATA")
"""Variables of Windows with the paths of such folders."""
_WINDOWS_DEVICE = re.compile(r"(con|prn|aux|nul|conin\$|conout\$|(com|lpt)[0-9¹²³]) *([.:].*)?")
"""Names of devices in every folder, with any ending."""


def system_tree(
    place: PurePath, platform: str = sys.platform, variables: Mapping[str, str] = os.environ
) -> str:
    """Reason, as the end of a message, why a path belongs to the system; empty if it does not.

    Args:
        place: Absolute path, links resolved.
        platform: As `sys.platform`.
        variables: The environment, which on Windows has the paths of the system.
    """
    if platform == "win32":
        if place.anchor.startswith("\\\\.\\") or any(map(_names_device, place.parts[1:])):
            return "is a device"
        trees = _named(variables, _WINDOWS_TREES)
        return "belongs to the system" if _is_below(place, trees, platform) else ""
    if _is_below(place, (_SHARED_MEMORY,), platform):
        return ""
    if _is_below(place, _DEVICES, platform):
        return "is a device folder"
    return "belongs to the system" if _is_below(place, _TREES, platform) else ""


def is_shared(
    place: PurePath, platform: str = sys.platform, variables: Mapping[str, str] = os.environ
) -> bool:
    """True if a folder is shared by many users or programs, so that results need a folder of their
    own in it; arguments as `system_tree`.
    """
    if platform == "win32":
        homes = [str(PureWindowsPath(text).parent) for text in _named(variables, ["USERPROFILE"])]
        folders = [*_named(variables, _WINDOWS_SHARED), *homes]
    else:
        folders = [*_SHARED, *_named(variables, ["TMPDIR"])]
    return any(_parts(place, platform) == _parts(folder, platform) for folder in folders)


def _is_below(place: PurePath, folders: Iterable[str], platform: str) -> bool:
    """True if a path is one of the folders or below it."""
    parts = _parts(place, platform)
    above = [_parts(folder, platform) for folder in folders]
    return any(parts[: len(folder)] == folder for folder in above)


def _parts(path: PurePath | str, platform: str) -> list[str]:
    """Parts of a path, normalised so that paths equal to the system are equal.

    macOS and Windows ignore case; macOS has /etc, /tmp and /var below /private.
    """
    text = str(path)
    if platform == "win32":
        return [part for part in text.replace("\\", "/").lower().split("/") if part]
    parts = [part for part in text.split("/") if part]
    if platform != "darwin":
        return parts
    parts = [part.lower() for part in parts]
    return parts[1:] if parts[0:1] == ["private"] and len(parts) > 1 else parts


def _named(variables: Mapping[str, str], names: Iterable[str]) -> list[str]:
    """Folders named by variables of the environment."""
    return [variables[name] for name in names if variables.get(name)]


def _names_device(part: str) -> bool:
    return _WINDOWS_DEVICE.fullmatch(part.lower()) is not None
