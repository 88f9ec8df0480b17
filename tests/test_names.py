"""Names that mean one thing; oracle: the syntax trees."""

import ast
from collections import defaultdict
from pathlib import Path

PACKAGE = Path(__file__).parent.parent / "gscore"


def test_no_two_public_classes_share_a_name() -> None:
    """Oracle: the classes of all files: who reads a name has no need to ask which one is meant."""
    places = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(str(path.relative_to(PACKAGE)))
    assert len(places) > 100, "the files were found"
    assert {name: files for name, files in places.items() if len(files) > 1} == {}
