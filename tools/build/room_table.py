"""Room table of docs/architecture.md, generated from the docstrings of the packages.

`python tools/build/room_table.py` rewrites the part of the page between two markers; `--check`
only compares, and exits with 1 if they differ.
"""

import ast
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "architecture.md"
BEGIN, END = "<!-- rooms: begin -->", "<!-- rooms: end -->"


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


def table() -> str:
    """The table as Markdown, between the markers."""
    rows = [f"| `{folder}/` | {purpose} |" for folder, purpose in rooms()]
    return "\n".join([BEGIN, "", "| room | purpose |", "|---|---|", *rows, "", END])


def main() -> int:
    """Rewrite or check the page."""
    text = PAGE.read_text(encoding="utf-8")
    head, _, rest = text.partition(BEGIN)
    _, _, tail = rest.partition(END)
    new = head + table() + tail
    if "--check" in sys.argv[1:]:
        return int(new != text)
    PAGE.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
