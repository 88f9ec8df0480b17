"""Names that mean one thing; oracle: the syntax trees."""

import ast
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path

PACKAGE = Path(__file__).parent.parent / "gscore"
TWINS = {
    "raster/screen_gradients.py, raster/_native.py": "add_pull",  # the door and the library's function
    "raster/packing.py, raster/_native.py": "pack_rows unpack_rows",
    "__main__.py, commands/__init__.py": "main",  # of the process, and of a list of words
    "io/colmap/binary.py, io/colmap/text.py": "count_images read_cameras read_images read_points",
    "raster/stereo.py, raster/reference/stereo.py": "check sweep",
    "raster/match.py, raster/reference/match.py": "match_descriptors",
    "raster/mesh.py, raster/reference/mesh.py": "mesh_depth",
    "transforms.py, raster/reference/geometry.py": "quat_to_rotmat",
    "sh.py, raster/reference/harmonics.py": "sh_basis",
    "metrics/image.py, raster/reference/loss.py": "WINDOW SIGMA C1 C2",
}
"""Names that two files share on purpose: one thing for two kinds of files or arrays, or a formula
and its float64 twin, which must not borrow what it is there to check."""
VERBS = {"add_arguments", "run"}
"""What every file of a verb has."""


def places_of(found: Callable[[ast.Module], Iterator[str]]) -> dict[str, list[str]]:
    """Files by the public names that `found` gives of their trees."""
    places = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        for name in found(ast.parse(path.read_text(encoding="utf-8"))):
            if not name.startswith("_"):
                places[name].append(str(path.relative_to(PACKAGE)))
    return places


def shared(places: dict[str, list[str]]) -> dict[str, list[str]]:
    """Names of several files that are no deliberate twins."""
    twins = {
        (name, frozenset(files.split(", ")))
        for files, names in TWINS.items()
        for name in names.split()
    }
    return {
        name: files
        for name, files in places.items()
        if len(files) > 1
        and (name, frozenset(files)) not in twins
        and not (name in VERBS and all(file.startswith("commands/") for file in files))
    }


def classes(tree: ast.Module) -> Iterator[str]:
    """All of them, inner ones too."""
    return (node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef))


def functions(tree: ast.Module) -> Iterator[str]:
    """Those that a file offers; methods belong to their classes."""
    return (node.name for node in tree.body if isinstance(node, ast.FunctionDef))


def constants(tree: ast.Module) -> Iterator[str]:
    """What a file assigns at its top, type variables apart: these name nothing."""
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else []
        targets = [node.target] if isinstance(node, ast.AnnAssign) else targets
        value = node.value if isinstance(node, ast.Assign | ast.AnnAssign) else None
        if isinstance(value, ast.Call) and ast.unparse(value.func) == "TypeVar":
            continue
        for inner in (name for target in targets for name in ast.walk(target)):
            if isinstance(inner, ast.Name):
                yield inner.id


def test_no_two_public_classes_share_a_name() -> None:
    """Oracle: the classes of all files: who reads a name has no need to ask which one is meant."""
    places = places_of(classes)
    assert len(places) > 100, "the files were found"
    assert shared(places) == {}


def test_no_two_public_functions_share_a_name() -> None:
    """Oracle: the functions of all files, but for twins that are named here."""
    places = places_of(functions)
    assert len(places) > 500, "the files were found"
    assert shared(places) == {}


def test_no_two_public_constants_share_a_name() -> None:
    """Oracle: what all files assign, but for twins that are named here."""
    places = places_of(constants)
    assert len(places) > 150, "the files were found"
    assert shared(places) == {}


def test_twins_are_there() -> None:
    """Oracle: the names of the files: a twin that was renamed leaves the list."""
    for files, names in TWINS.items():
        for file in files.split(", "):
            tree = ast.parse((PACKAGE / file).read_text(encoding="utf-8"))
            assert set(names.split()) <= {*functions(tree), *constants(tree)}, file
