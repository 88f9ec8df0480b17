"""Developers' scripts, which no test of their own runs; oracle: the modules they import from."""

import ast
import re
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from runpy import run_path

import pytest

from tests.for_each import for_each

ROOT = Path(__file__).parent.parent
SCRIPTS = sorted(
    path
    for folder in ("tools", "experiments", "examples", "tests/window")
    for path in (ROOT / folder).rglob("*.py")
)


@for_each(SCRIPTS)
def test_names_that_scripts_import_exist(path: Path) -> None:
    """Oracle: gscore itself; nobody notices otherwise when a name of it moves."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.ImportFrom) or node.level or not node.module:
            continue
        if node.module.split(".")[0] != "gscore":
            continue
        module = import_module(node.module)
        for alias in node.names:
            there = hasattr(module, alias.name) or find_spec(f"{node.module}.{alias.name}")
            assert there, f"line {node.lineno}: {node.module} has no {alias.name}"


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_what_scripts_take_from_the_addon_is_there(path: Path) -> None:
    """Oracle: the syntax trees of the add-on, which only Blender can import."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith("addon"):
            continue
        module = ROOT / (node.module or "").replace(".", "/")
        source = module / "__init__.py" if module.is_dir() else module.with_suffix(".py")
        names = _names(ast.parse(source.read_text(encoding="utf-8")))
        if module.is_dir():
            names |= {entry.stem for entry in module.iterdir()}
        for package in ("gscore", "gscore.frontend") if "*" in names else ():
            names |= set(import_module(package).__all__)  # `addon.core` has all their names
        missing = {alias.name for alias in node.names} - names
        assert not missing, f"line {node.lineno}: {node.module} has no {', '.join(missing)}"


def _names(tree: ast.AST) -> set[str]:
    """All names that a module defines or imports."""
    found = {n.name for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.ClassDef)}
    found |= {n.asname or n.name for n in ast.walk(tree) if isinstance(n, ast.alias)}
    stored = (n for n in ast.walk(tree) if isinstance(n, ast.Name))
    return found | {n.id for n in stored if isinstance(n.ctx, ast.Store)}


def test_each_script_has_one_place() -> None:
    """Oracle: the folders: what makes something, what breaks it, what measures it, and what those
    and tests need to open windows."""
    assert {path.name for path in (ROOT / "tools").iterdir() if path.name != "__pycache__"} == {
        "build",
        "break",
        "measure",
        "window",
    }
    names = [path.name for path in (ROOT / "tools").rglob("*.py")]
    assert len(names) == len(set(names))


def test_every_fuzz_target_gets_its_time() -> None:
    """Oracle: csrc/CMakeLists.txt, which builds them, and the folders of what they found."""
    names = run_path(str(ROOT / "tools" / "break" / "fuzz.py"))
    built = re.search(r"set\(fuzz_targets ([\w ]+)\)", (ROOT / "csrc/CMakeLists.txt").read_text())
    assert built and set(built[1].split()) == set(names["TARGETS"])
    for target in names["TARGETS"]:
        assert (ROOT / "csrc" / "fuzz" / f"fuzz_{target}.cpp").exists()
        assert (ROOT / "tests" / "fuzz" / "cases" / target).is_dir()
    assert sum(names["TARGETS"].values()) + names["READERS"] + names["SCENES"] == pytest.approx(1)
