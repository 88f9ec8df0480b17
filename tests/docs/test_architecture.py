"""docs/architecture.md; oracle: the folders themselves."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
SPANS = set(re.findall(r"`([^`\n]+)`", PAGE))
PLACES = (ROOT, ROOT / "gscore", ROOT / "csrc" / "src", ROOT / "csrc", ROOT / "addon")
"""Folders from which the page names files."""
SUFFIXES = (".py", ".cpp", ".h", ".md", ".txt")


def _rows(room: str) -> set[str]:
    """The files that the table of a room names in its first column."""
    (table,) = re.findall(
        rf"^\| in `{room}/` \| what \|\n\|---\|---\|\n((?:\|.*\n)+)", PAGE, flags=re.MULTILINE
    )
    cells = [row.split("|")[1] for row in table.splitlines()]
    return {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}


@pytest.mark.parametrize("room", ["trainer", "commands", "bench", "sfm", "video"])
def test_every_file_of_a_room_has_its_line(room: str) -> None:
    """Oracle: the folder; a new file is named in the table of its room, a removed one is not."""
    folder = ROOT / "gscore" / room
    there = {str(p.relative_to(folder).with_suffix("")) for p in folder.rglob("*.py")}
    there = {name for name in there if not name.endswith("__init__")}
    named = _rows(room)
    whole = {name.rstrip("/") for name in named if name.endswith("/")}
    covered = {name for name in there if name.split("/")[0] in whole}
    assert there - named - covered == set(), "files without a line"
    assert {name for name in named if not name.endswith("/")} - there == set(), "lines without file"
    assert all((folder / name).is_dir() for name in whole)


def test_every_native_file_is_named() -> None:
    """Oracle: csrc/src; a header goes with the source of its name."""
    there = {path.name.split(".")[0] for path in (ROOT / "csrc" / "src").iterdir()}
    there = {name for name in there if not name.startswith("kernels_")}
    named = {span.split(".")[0] for span in SPANS if span.endswith((".cpp", ".h"))}
    assert there - named == set()


def test_every_path_on_the_page_leads_somewhere() -> None:
    """Oracle: the file system, from the folders that the page speaks of."""
    paths = {span for span in SPANS if re.fullmatch(r"\w[\w./*-]*", span)}
    paths = {span for span in paths if span.endswith((*SUFFIXES, "/")) and "NAME" not in span}
    lost = [
        span
        for span in sorted(paths)
        if not any(list(place.glob(span.rstrip("/"))) for place in PLACES)
        and not list((ROOT / "gscore").rglob(span.rstrip("/")))
    ]
    assert lost == []
