"""docs/architecture.md; oracle: the folders themselves."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
SPANS = set(re.findall(r"`([^`\n]+)`", PAGE))
PLACES = (ROOT, ROOT / "gscore", ROOT / "csrc" / "src", ROOT / "csrc", ROOT / "addon")
"""Folders from which the page names files."""
CHANGES = (
    "an option of a training",
    "a loss term on opacity or depth",
    "a strategy",
    "a PLY dialect",
    "a camera model",
    "a metric",
    "an event",
    "a panel button",
    "a kernel for another instruction set",
    "a fault test",
)
"""What a stranger is expected to find the files for with this page alone."""
SUFFIXES = (".py", ".cpp", ".h", ".md", ".txt")


def _rows(room: str) -> set[str]:
    """The files that the table of a room names in its first column."""
    (table,) = re.findall(
        rf"^\| in `{room}/` \| what \|\n\|---\|---\|\n((?:\|.*\n)+)", PAGE, flags=re.MULTILINE
    )
    cells = [row.split("|")[1] for row in table.splitlines()]
    return {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}


@pytest.mark.parametrize(
    "room",
    ["trainer", "commands", "formats", "bench", "edit", "sfm", "video", "page", "live", "lod"],
)
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


def _found(span: str) -> list[Path]:
    """Files that a name on the page leads to."""
    there = [path for place in PLACES for path in place.glob(span.rstrip("/"))]
    return there or list((ROOT / "gscore").rglob(span.rstrip("/")))


def _to_add() -> dict[str, tuple[str, str]]:
    """Cells of "Where to change what" by what is to be added: what to touch, and the test."""
    (table,) = re.findall(
        r"^\| to add \| touch \| test \|\n\|---\|---\|---\|\n((?:\|.*\n)+)",
        PAGE,
        flags=re.MULTILINE,
    )
    rows = ([cell.strip() for cell in row.split("|")[1:-1]] for row in table.splitlines())
    return {what: (touch, test) for what, touch, test in rows}


@pytest.mark.parametrize("what", sorted({*CHANGES, *_to_add()}))
def test_who_adds_something_is_led_to_files_that_hold_it(what: str) -> None:
    """Oracle: the files: each that a row names is there, and one of them holds each other name."""
    touch, test = _to_add()[what]
    spans = re.findall(r"`([^`]+)`", touch)
    paths = [span for span in spans if span.endswith((*SUFFIXES, "/")) and "NAME" not in span]
    pages = re.findall(r"\bdocs/[\w-]+\.md", touch)
    assert all(_found(path) for path in [*paths, *pages]), touch
    files = [file for path in paths for file in _found(path) if file.is_file()]
    assert files or any(file.is_dir() for path in spans for file in _found(path))
    texts = [file.read_text(encoding="utf-8") for file in files]
    names = [word for span in spans if (word := re.fullmatch(r"@?(\w+)(\(\))?", span))]
    for name in names:
        assert any(re.search(rf"\b{name[1]}\b", text) for text in texts), f"{name[0]}: {touch}"
    tests = [span for span in re.findall(r"`([^`]+)`", test) if "/" in span]
    assert all(_found(span) for span in tests), test
