"""Buttons of the Blender manual; oracle: the labels in the add-on's source."""

import ast
import re
from collections import defaultdict
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MANUAL = ROOT / "docs" / "blender.md"
PAGES = sorted((ROOT / "docs" / "blender").glob("*.md"))
HEADS = ("| button | does |", "| setting | does |", "| display | shows | for |")
PICTURED = re.compile(
    r"^(arrows?|film strip|magnifying glass|folder field|cross|sequence icon|eye, .*)$"
)
"""Buttons that have an icon and no label."""


@cache
def trees() -> list[ast.Module]:
    """The syntax trees of the add-on."""
    files = sorted((ROOT / "addon").rglob("*.py"))
    return [ast.parse(file.read_text(encoding="utf-8")) for file in files]


@cache
def labels() -> set[str]:
    """Every string of the add-on, as are labels of buttons, fields and panels."""
    nodes = (node for tree in trees() for node in ast.walk(tree))
    return {n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)}


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


def operators() -> dict[str, str]:
    """The label of each operator of the add-on, by its id."""
    found: dict[str, str] = {}
    for node in (n for tree in trees() for n in ast.walk(tree) if isinstance(n, ast.ClassDef)):
        fields = {
            line.targets[0].id: line.value.value
            for line in node.body
            if isinstance(line, ast.Assign)
            and isinstance(line.targets[0], ast.Name)
            and isinstance(line.value, ast.Constant)
        }
        if str(fields.get("bl_idname", "")).startswith("gscore."):
            found[fields["bl_idname"]] = fields["bl_label"]
    return found


def buttons() -> dict[str, set[str]]:
    """Texts of the buttons that draw each operator; its label where a button has an icon only or
    composes its text."""
    found, labels = defaultdict[str, set[str]](set), operators()
    for node in (n for tree in trees() for n in ast.walk(tree) if isinstance(n, ast.Call)):
        name = node.args[0] if node.args else None
        if getattr(node.func, "attr", "") != "operator" or not isinstance(name, ast.Constant):
            continue
        if name.value in labels:
            text = next((key.value for key in node.keywords if key.arg == "text"), None)
            given = text.value if isinstance(text, ast.Constant) else ""
            found[name.value].add(given or labels[name.value])
    return found


def test_every_button_is_in_the_manual() -> None:
    """Oracle: the first columns of the tables of buttons and the emphasised words of all pages."""
    text = " ".join(page.read_text(encoding="utf-8") for page in (MANUAL, *PAGES)).split()
    emphasised = re.findall(r"(?<!\*)\*{1,2}([^*|]+)\*{1,2}", " ".join(text))
    known = {word for words in emphasised for word in re.split(r" > |, ", words)}
    known |= {name for page in PAGES for name in named(page)}
    drawn = buttons()
    assert len(drawn) > 60
    assert {name: found for name, texts in drawn.items() if (found := texts - known)} == {}


def test_the_tables_are_found() -> None:
    """Oracle: buttons that the manual must have."""
    everything = [name for page in PAGES for name in named(page)]
    assert len(everything) > 80
    assert {"Import Cameras", "Train", "Show Splats", "Grade", "Measure Errors"} <= set(everything)
