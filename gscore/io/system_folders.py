"""System folders of Linux, macOS and Windows, where no results may be written."""

import os
import re
import sys
from collections.abc import Iterable, Mapping
from pathlib import PurePath, PureWindowsPath

_DEVICES = ("/dev", "/proc", "/sys")
"""Folders whose files are no files; but shared memory is as good as a disk."""
_SHARED_MEMORY = "/dev/shm"
_TREES = (
    *("/bin", "/boot", "/cores", "/etc", "/lib", "/lib32", "/lib64", "/libx32", "/sbin"),
    *("/usr/bin", "/usr/include", "/usr/lib", "/usr/lib32", "/usr/lib64", "/usr/libexec"),
    *("/usr/libx32", "/usr/sbin", "/usr/share", "/usr/standalone", "/Library", "/System"),
)
"""What the system consists of: nothing below them is anybody's own."""
_SHARED = (
    *(_SHARED_MEMORY, "/home", "/media", "/mnt", "/opt", "/private", "/root", "/run", "/srv"),
    *("/tmp", "/usr", "/usr/home", "/usr/local", "/usr/local/bin", "/usr/local/etc"),
    *("/usr/local/lib", "/usr/local/sbin", "/usr/local/share", "/usr/src", "/var", "/var/cache"),
    *("/var/folders", "/var/home", "/var/lib", "/var/log", "/var/spool", "/var/tmp"),
    *("/Applications", "/Users", "/Users/Shared", "/Volumes"),
)
"""Where folders of many users and programs lie side by side: a folder in them is fine."""
_WINDOWS_TREES = ("SystemRoot", "ProgramFiles", "ProgramFiles(x86)", "ProgramW6432")
_WINDOWS_SHARED = ("ProgramData", "PUBLIC", "TEMP", "TMP", "APPDATA", "LOCALAPPDATA")
"""Variables of Windows that say where such folders lie, on whichever drive."""
_WINDOWS_DEVICE = re.compile(r"(con|prn|aux|nul|conin\$|conout\$|(com|lpt)[0-9¹²³]) *([.:].*)?")
"""Names that are devices in every folder, with any ending."""


def system_tree(
    place: PurePath, platform: str = sys.platform, variables: Mapping[str, str] = os.environ
) -> str:
    """What is wrong with a place, as the end of a sentence, if nothing there is a user's own; else
    nothing.

    Args:
        place: Absolute, links followed.
        platform: As `sys.platform`.
        variables: The environment, which on Windows says where the system lies.
    """
    if platform == "win32":
        if place.anchor.startswith("\\\\.\\") or any(map(_names_device, place.parts[1:])):
            return "is a device"
        trees = _named(variables, _WINDOWS_TREES)
        return "belongs to the system" if _is_below(place, trees, platform) else ""
    if _is_below(place, (_SHARED_MEMORY,), platform):
        return ""
    if _is_below(place, _DEVICES, platform):
        return "lies among devices"
    return "belongs to the system" if _is_below(place, _TREES, platform) else ""


def is_shared(
    place: PurePath, platform: str = sys.platform, variables: Mapping[str, str] = os.environ
) -> bool:
    """Whether many users' and programs' folders lie in a place, so that results want one of their
    own; the arguments are those of `system_tree`.
    """
    if platform == "win32":
        homes = [str(PureWindowsPath(text).parent) for text in _named(variables, ["USERPROFILE"])]
        folders = [*_named(variables, _WINDOWS_SHARED), *homes]
    else:
        folders = [*_SHARED, *_named(variables, ["TMPDIR"])]
    return any(_parts(place, platform) == _parts(folder, platform) for folder in folders)


def _is_below(place: PurePath, folders: Iterable[str], platform: str) -> bool:
    """Whether a place is one of the folders or lies in it."""
    parts = _parts(place, platform)
    above = [_parts(folder, platform) for folder in folders]
    return any(parts[: len(folder)] == folder for folder in above)


def _parts(path: PurePath | str, platform: str) -> list[str]:
    """The parts of a path, equal where the system takes paths for equal.

    macOS and Windows do not tell capitals apart; macOS has /etc, /tmp and /var below /private.
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
    """The folders that variables of the environment name."""
    return [variables[name] for name in names if variables.get(name)]


def _names_device(part: str) -> bool:
    return _WINDOWS_DEVICE.fullmatch(part.lower()) is not None
