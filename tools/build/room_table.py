"""Tables of docs/architecture.md: rooms by docstrings of packages, native files by their comments.

`python tools/build/room_table.py` rewrites the parts of the page between markers; `--check` only
compares, and exits with 1 if they differ.
"""

import ast
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "architecture.md"
NATIVE = {
    "native files": ROOT / "csrc" / "src",
    "files for graphics cards": ROOT / "csrc" / "gpu",
    "shaders": ROOT / "csrc" / "gpu" / "shaders",
}
"""Folders of native files by the name of their table."""
_ENDINGS = (".h", ".inl.h", ".cpp", ".glsl", ".comp")
"""Endings of files of one name; the first comment of the first of them states their purpose."""


def _purpose(path: Path) -> str:
    """The first paragraph of a module's docstring as one line."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split())


def rooms() -> list[tuple[str, str]]:
    """Folder and purpose of each package of gscore and the add-on."""
    result = []
    for package in ("gscore", "addon"):
        for path in sorted((ROOT / package).rglob("__init__.py")):
            folder = path.parent.relative_to(ROOT).as_posix()
            result.append((folder, _purpose(path)))
    return result


def _first_sentence(path: Path) -> str:
    """The comment at the beginning of a file, up to the end of a sentence at a line's end."""
    words: list[str] = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith(("//", "/*", " *")):
            break
        words += line.lstrip("/* ").split()
        if words[-1].endswith("."):
            break
    return " ".join(words)


def native_files(folder: Path) -> list[tuple[str, str]]:
    """File names of each part of a folder, and its purpose."""
    parts: dict[str, list[str]] = {}
    for path in folder.iterdir():
        name, _, ending = path.name.partition(".")
        if path.is_file():
            parts.setdefault(name, []).append(f".{ending}")
    result = []
    for name, endings in sorted(parts.items()):
        files = [f"{name}{ending}" for ending in sorted(endings, key=_ENDINGS.index)]
        result.append(("`, `".join(files), _first_sentence(folder / files[0])))
    return result


def _put(text: str, kind: str, table: list[str]) -> str:
    """The text of a page with another table between the markers of `kind`."""
    begin, end = f"<!-- {kind}: begin -->", f"<!-- {kind}: end -->"
    head, _, rest = text.partition(begin)
    _, _, tail = rest.partition(end)
    return head + "\n".join([begin, "", *table, "", end]) + tail


def page(text: str) -> str:
    """The page with current tables."""
    rows = [f"| `{folder}/` | {purpose} |" for folder, purpose in rooms()]
    text = _put(text, "rooms", ["| room | purpose |", "|---|---|", *rows])
    for name, folder in NATIVE.items():
        rows = [f"| `{files}` | {purpose} |" for files, purpose in native_files(folder)]
        text = _put(text, name, ["| files | purpose |", "|---|---|", *rows])
    return text


def main() -> int:
    """Rewrite or check the page."""
    text = PAGE.read_text(encoding="utf-8")
    new = page(text)
    if "--check" in sys.argv[1:]:
        return int(new != text)
    PAGE.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
