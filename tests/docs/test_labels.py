"""Buttons of the Blender manual; oracle: the labels in the add-on's source."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs" / "blender").glob("*.md"))
HEADS = ("| button | does |", "| setting | does |", "| display | shows | for |")
PICTURED = re.compile(
    r"^(arrows?|film strip|magnifying glass|folder field|cross|sequence icon|eye, .*)$"
)
"""Buttons that have an icon and no label."""


@cache
def labels() -> set[str]:
    """Every string of the add-on, as are labels of buttons, fields and panels."""
    found: set[str] = set()
    for file in (ROOT / "addon").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.add(node.value)
    return found


def named(page: Path) -> list[str]:
    """Labels in the first column of the page's tables of buttons."""
    result, inside = [], False
    for line in page.read_text(encoding="utf-8").splitlines():
        inside = line in HEADS or (inside and line.startswith("|"))
        if inside and line not in HEADS and not line.startswith("|---"):
            cell = line.split("|")[1].strip()
            if not PICTURED.match(cell):
                result += [n for n in re.split(r" > |, (?:or )?", cell) if n]
    return result


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_buttons_are_called_as_in_blender(page: Path) -> None:
    """Oracle: the labels; a button that is renamed is renamed in the manual."""
    assert [name for name in named(page) if name not in labels()] == []


def test_the_tables_are_found() -> None:
    """Oracle: buttons that the manual must have."""
    everything = [name for page in PAGES for name in named(page)]
    assert len(everything) > 80
    assert {"Import Cameras", "Train", "Show Splats", "Grade", "Measure Errors"} <= set(everything)
