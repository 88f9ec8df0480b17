"""Public names use the field's terms; oracle: the syntax trees and docs/glossary.md."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from tests.for_each import for_each
from tests.native_sources import own_sources

ROOT = Path(__file__).parent.parent
FILES = sorted(
    path for name in ("gscore", "addon", "tools", "tests") for path in (ROOT / name).rglob("*.py")
)
PRODUCT = [path for path in FILES if path.relative_to(ROOT).parts[0] in ("gscore", "addon")]
NATIVE = own_sources(ROOT / "csrc")
GLOSSARY = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
STOPPED = {
    *("told", "hear", "heard", "glance", "glances", "sight", "sightings", "beside", "aside"),
    *("wish", "onlooker", "onlookers", "judged", "learnt", "apart", "alike", "premises"),
    *("succession", "leaving", "placing", "strangers", "together", "pull", "drift"),
    *("settle", "settled", "judge", "learned", "taught", "rival", "witness"),
    *("said", "asked", "beat", "pieces", "painter", "beginning", "wanted"),
}
"""Words that no name of a module, class, function, method, constant, field, attribute or argument
uses: the field has a noun for each of them."""
IN_NATIVE = {"wanted", "asked"}
"""Those that local variables of the native code use; Python's are not checked."""
IN_SENTENCES = {
    *("together", "beside", "apart", "alike", "leaving", "settle", "aside"),
    *("said", "asked", "beat", "pieces", "painter", "beginning", "wanted"),
}
"""Those that names of tests, which are sentences, may use."""
STORED = {"asked"}
"""Fields of files, whose names stay."""
FRAGMENT = re.compile(r"(Of|As|By|None:|0:|What|Which|How|Where|Who)\b")
"""Begins a docstring that does not name its thing."""


def _words(name: str) -> set[str]:
    """The lower-case words of a name in any case style."""
    return set(re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", name).lower().split("_"))


def _bound(target: ast.expr | None) -> Iterator[str]:
    """Names that an assignment's target binds, those of tuples too."""
    if isinstance(target, ast.Name):
        yield target.id
    elif isinstance(target, ast.Tuple | ast.List):
        for one in target.elts:
            yield from _bound(one)
    elif isinstance(target, ast.Starred):
        yield from _bound(target.value)


def _defined(tree: ast.Module) -> Iterator[str]:
    """Classes, functions and methods of a module, and its constants and fields."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.name
        if isinstance(node, ast.Module | ast.ClassDef):
            for line in node.body:
                targets = (
                    line.targets
                    if isinstance(line, ast.Assign)
                    else [getattr(line, "target", None)]
                )
                for target in targets:
                    yield from _bound(target)


def _assigned(tree: ast.Module) -> Iterator[str]:
    """Arguments of a module's functions, and the attributes that its code sets."""
    for node in ast.walk(tree):
        if isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr


@for_each(FILES)
def test_names_avoid_stopped_words(path: Path) -> None:
    """Oracle: STOPPED."""
    text, stopped = path.read_text(encoding="utf-8"), STOPPED
    if not any(word in f"{path}{text}".lower() for word in STOPPED):
        return
    tree = ast.parse(text)
    names = {path.stem, path.parent.name, *_defined(tree)}
    if path.relative_to(ROOT).parts[0] == "tests":
        stopped = STOPPED - IN_SENTENCES
    else:
        names |= set(_assigned(tree))
    assert {name for name in names - STORED if _words(name) & stopped} == set()


def test_names_are_found_where_they_are_bound() -> None:
    """Oracle: the code; each name is bound in another way."""
    tree = ast.parse(
        "told, (glance, *heard) = 1, (2, 3)\n"
        "class Judge:\n"
        "    rival: int\n"
        "    def settle(self, drift, *, pull): self.witness, other.wish = drift, pull\n"
    )
    assert set(_defined(tree)) == {"told", "glance", "heard", "Judge", "rival", "settle"}
    assert set(_assigned(tree)) == {"self", "drift", "pull", "witness", "wish"}


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
    assert {name for name in names if _words(name) & (STOPPED - IN_NATIVE)} == set()


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
    assert names - set(re.findall(r"\w+", text)) == set()
