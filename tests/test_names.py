"""Public names use the field's terms; oracle: the syntax trees and docs/glossary.md."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from tests.for_each import for_each

ROOT = Path(__file__).parent.parent
FILES = sorted(
    path for name in ("gscore", "addon", "tools", "tests") for path in (ROOT / name).rglob("*.py")
)
PRODUCT = [path for path in FILES if path.relative_to(ROOT).parts[0] in ("gscore", "addon")]
NATIVE = sorted(path for path in (ROOT / "csrc").rglob("*") if path.suffix in (".h", ".cpp"))
GLOSSARY = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
STOPPED = {
    *("told", "hear", "heard", "glance", "glances", "sight", "sightings", "beside", "aside"),
    *("wish", "onlooker", "onlookers", "judged", "learnt", "apart", "alike", "premises"),
    *("succession", "leaving", "placing", "strangers", "together", "pull", "drift"),
    *("settle", "settled", "judge", "learned", "taught", "rival", "witness"),
}
"""Words that no name of a module, class, function, method or constant uses: the field has a noun
for each of them."""
IN_SENTENCES = {"together", "beside", "apart", "alike", "leaving", "settle", "aside"}
"""Those that names of tests, which are sentences, may use."""
FRAGMENT = re.compile(r"(Of|As|By|None:|0:|What|Which|How|Where|Who)\b")
"""Begins a docstring that does not name its thing."""


def _words(name: str) -> set[str]:
    """The lower-case words of a name in any case style."""
    return set(re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", name).lower().split("_"))


def _defined(tree: ast.Module) -> Iterator[str]:
    """Classes, functions and methods of a module, and its constants and fields."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            yield node.name
        if isinstance(node, ast.Module | ast.ClassDef):
            for line in node.body:
                targets = (
                    line.targets
                    if isinstance(line, ast.Assign)
                    else [getattr(line, "target", None)]
                )
                yield from (target.id for target in targets if isinstance(target, ast.Name))


@for_each(FILES)
def test_names_avoid_stopped_words(path: Path) -> None:
    """Oracle: STOPPED."""
    names = [path.stem, path.parent.name, *_defined(ast.parse(path.read_text(encoding="utf-8")))]
    stopped = STOPPED - IN_SENTENCES if "tests" in path.parts else STOPPED
    assert {name for name in names if _words(name) & stopped} == set()


@for_each(PRODUCT)
def test_docstrings_name_their_thing(path: Path) -> None:
    """Oracle: FRAGMENT; all strings that are statements, those of fields and constants too."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    texts = [
        node.value.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    ]
    assert [text for text in texts if FRAGMENT.match(text)] == []


@for_each(NATIVE)
def test_native_names_avoid_stopped_words(path: Path) -> None:
    """Oracle: STOPPED; all words of the code, which has no strings of prose."""
    code = re.sub(r"//.*|/\*[\s\S]*?\*/|\"[^\"]*\"", "", path.read_text(encoding="utf-8"))
    names = {path.stem, *re.findall(r"\w+", code)}
    assert {name for name in names if _words(name) & STOPPED} == set()


def test_no_two_public_classes_share_a_name() -> None:
    """Oracle: the classes of all files of gscore: tracebacks and type checkers print them bare."""
    places = defaultdict(list)
    for path in sorted((ROOT / "gscore").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(path.name)
    assert len(places) > 100, "the files were found"
    assert {name: files for name, files in places.items() if len(files) > 1} == {}


def test_the_glossary_names_what_is_there() -> None:
    """Oracle: the code: each name that the glossary gives in its second column is defined."""
    rows = re.findall(r"^\| [^|]+ \| ([^|]+) \| [^|]+ \|$", GLOSSARY, flags=re.MULTILINE)[1:]
    names = {name for row in rows for name in re.findall(r"`(\w+)`", row)}
    text = "\n".join(path.read_text(encoding="utf-8") for path in PRODUCT)
    assert len(names) > 40
    assert {name for name in names if not re.search(rf"\b{name}\b", text)} == set()
