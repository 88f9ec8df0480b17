"""docs/architecture.md; oracle: the folders themselves."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
SPANS = set(re.findall(r"`([^`\n]+)`", PAGE))
CSRC = ROOT / "csrc"
PLACES = (
    *(ROOT, ROOT / "gscore", CSRC, CSRC / "src", CSRC / "gpu", CSRC / "gpu" / "shaders"),
    ROOT / "addon",
)
"""Folders from which the page names files."""
CHANGES = (
    "an option of a training",
    "a loss term on rendered opacity or depth",
    "a strategy",
    "a PLY dialect",
    "a lens model",
    "a metric",
    "an event",
    "a panel button",
    "a kernel for another instruction set",
    "a fault test",
)
"""What a stranger is expected to find the files for with this page alone."""
SUFFIXES = (".py", ".cpp", ".h", ".md", ".txt")


def test_the_generated_tables_are_current() -> None:
    """Oracle: the docstrings of the packages and the first comments of the native files;
    tools/build/room_table.py writes both tables."""
    program = ROOT / "tools" / "build" / "room_table.py"
    assert subprocess.run([sys.executable, program, "--check"], check=False).returncode == 0


def test_every_native_file_states_its_purpose() -> None:
    """Oracle: csrc/src: each file begins with a comment, and the page names each."""
    there = sorted((ROOT / "csrc" / "src").iterdir())
    assert [p.name for p in there if not p.read_text(encoding="utf-8").startswith("// ")] == []
    assert {path.name for path in there} - set(SPANS) == set()


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
def test_where_to_change_table_names_the_right_files(what: str) -> None:
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
