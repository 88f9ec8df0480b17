"""Folders for results: not those that all users and programs share."""

import os
import tempfile
from pathlib import Path

import pytest

from gscore.errors import ConfigError
from gscore.io.output_paths import check_output_path, check_separate


def test_folders_of_temporary_files_are_shared(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Oracle: the sticky bit, and Python's folder of temporary files; folders in them, and single
    files, are accepted."""
    for folder in (sticky := tmp_path / "sticky", temporary := tmp_path / "temporary"):
        folder.mkdir()
    check_output_path(sticky)
    sticky.chmod(0o1777)
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    for folder in (sticky, temporary):
        with pytest.raises(ConfigError, match="is shared by many programs"):
            check_output_path(folder)
        check_output_path(folder / "mine")
        check_separate(folder)


@pytest.mark.skipif(os.name == "nt", reason="users without a home are a matter of containers")
def test_a_user_without_a_home(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Oracle: a user id without an account, for which Python finds no home folder."""
    monkeypatch.delenv("HOME")
    monkeypatch.setattr(os, "getuid", lambda: 4_000_000)
    with pytest.raises(RuntimeError):
        Path("~").expanduser()
    check_output_path(tmp_path / "run")
