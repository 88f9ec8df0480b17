"""Folders of the system, on every platform, and users' folders next to them."""

import os
from pathlib import Path, PurePosixPath, PureWindowsPath

import pytest

from gscore.errors import ConfigError
from gscore.io.output_paths import check_output_path, check_separate
from gscore.io.system_folders import is_shared, system_tree

WINDOWS = {
    "SystemRoot": r"C:\Windows",
    "ProgramFiles": r"C:\Program Files",
    "ProgramFiles(x86)": r"C:\Program Files (x86)",
    "ProgramData": r"C:\ProgramData",
    "USERPROFILE": r"D:\Users\ada",
    "TEMP": r"D:\Users\ada\AppData\Local\Temp",
}


def judged(platform: str, text: str) -> str:
    """`system`, `shared` or `fine`, by the two functions for a path."""
    kind, variables = (PureWindowsPath, WINDOWS) if platform == "win32" else (PurePosixPath, {})
    place = kind(text)
    if system_tree(place, platform, variables):
        return "system"
    return "shared" if is_shared(place, platform, variables) else "fine"


@pytest.mark.parametrize(
    ("platform", "text", "wanted"),
    [
        *(("linux", text, "system") for text in ("/etc", "/etc/x/y", "/dev", "/dev/x", "/boot/x")),
        *(("linux", text, "system") for text in ("/usr/bin", "/usr/lib/python3", "/proc/1/fd")),
        *(("linux", text, "shared") for text in ("/tmp", "/usr", "/var", "/home", "/mnt", "/opt")),
        *(("linux", text, "fine") for text in ("/tmp/mine", "/home/ada", "/home/ada/etc/x")),
        *(("linux", text, "fine") for text in ("/dev/shm/x", "/usr/src/app/out", "/mnt/disk")),
        *(("linux", text, "fine") for text in ("/output", "/etcetera", "/device/x", "/var/x")),
        *(("darwin", text, "system") for text in ("/private/etc", "/System/x", "/library/x")),
        *(
            ("darwin", text, "shared")
            for text in ("/private/tmp", "/Users", "/Volumes", "/private")
        ),
        *(("darwin", text, "fine") for text in ("/Users/ada/Library/x", "/private/var/folders/x")),
        *(("darwin", text, "fine") for text in ("/Volumes/disk/x", "/private/tmp/mine")),
        *(("win32", text, "system") for text in (r"c:\windows\x", r"C:\PROGRAM FILES", "\\\\.\\x")),
        *(
            ("win32", text, "system")
            for text in (r"D:\work\nul", r"D:\work\COM1.d\x", r"D:\Aux .y")
        ),
        *(("win32", text, "shared") for text in (r"d:\users", r"C:\ProgramData", WINDOWS["TEMP"])),
        *(("win32", text, "fine") for text in (r"D:\Users\ada\run", r"C:\Windows.old", r"C:\etc")),
        *(("win32", text, "fine") for text in (r"D:\console\x", r"D:\com10", r"\\server\share\x")),
    ],
)
def test_owner_of_a_folder(platform: str, text: str, wanted: str) -> None:
    """Oracle: the system folders of the Filesystem Hierarchy Standard, Apple and Microsoft."""
    assert judged(platform, text) == wanted


def test_the_folder_of_temporary_files_is_told_by_the_environment() -> None:
    """Oracle: TMPDIR at any path, itself but not below."""
    variables = {"TMPDIR": "/scratch/tmp/"}
    assert is_shared(PurePosixPath("/scratch/tmp"), "linux", variables)
    assert not is_shared(PurePosixPath("/scratch/tmp/mine"), "linux", variables)


def test_single_files_may_lie_where_everything_lies() -> None:
    """Oracle: a film in the folder of temporary files, accepted; one among devices, refused."""
    check_separate(Path("/tmp"))
    with pytest.raises(ConfigError, match="/dev is a device folder"):
        check_separate(Path("/dev"))


@pytest.mark.skipif(os.name == "nt", reason="users without a home are a matter of containers")
def test_a_user_without_a_home(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Oracle: a user id without an account, for which Python finds no home folder."""
    monkeypatch.delenv("HOME")
    monkeypatch.setattr(os, "getuid", lambda: 4_000_000)
    with pytest.raises(RuntimeError):
        Path("~").expanduser()
    check_output_path(tmp_path / "run")
