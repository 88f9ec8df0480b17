"""The audit hook records the add-on's writes; it is active for all tests."""

from pathlib import Path

from tests.addon.writes import ADDON, Writes

LINES = """
def run(folder):
    (folder / "made").mkdir()
    (folder / "made" / "file").write_text("a")
    (folder / "made" / "file").rename(folder / "moved")
    (folder / "moved").read_text()
    (folder / "untouched").exists()
"""


def test_writes_of_the_addon_are_seen(tmp_path: Path, writes: Writes):
    names: dict = {}
    exec(compile(LINES, f"{ADDON}invented.py", "exec"), names)

    names["run"](tmp_path)

    made = {tmp_path / "made", tmp_path / "made" / "file", tmp_path / "moved"}
    assert {path for path in writes.paths if path.is_relative_to(tmp_path)} == made
    assert writes.outside(tmp_path) == []
    assert writes.outside(tmp_path / "made") == [tmp_path / "moved"]


def test_writes_of_others_are_not(tmp_path: Path, writes: Writes):
    (tmp_path / "of the test").write_text("a")

    assert tmp_path / "of the test" not in writes.paths
