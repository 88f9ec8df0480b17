"""The native sources as text; oracle: the length that conventions of this repository allow."""

import re
from collections.abc import Iterator
from pathlib import Path

from tests.for_each import for_each
from tests.native_sources import own_sources

CSRC = Path(__file__).parents[1] / "csrc"
LONGEST = 80
"""Lines of a function, from the line of its name to the brace that ends it."""
_SKIPPED = re.compile(
    r'//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])\'', flags=re.DOTALL
)
_DIRECTIVE = re.compile(r"^[ \t]*#(?:[^\n]*\\\n)*[^\n]*", flags=re.MULTILINE)
_NAME = re.compile(r"([\w~:]+|operator\s*\W+?)\s*\(")
_SCOPE = re.compile(r"\b(namespace|struct|class|union|enum|extern)\b[^()]*$")


def _functions(text: str) -> Iterator[tuple[str, int, int]]:
    """Name, first line and number of lines of each function; those inside others belong to them."""
    code = _blank(_SKIPPED, text)
    code = _blank(_DIRECTIVE, code)
    depth, outer, start, found = 0, 0, 0, None
    for at, letter in enumerate(code):
        if letter == "{":
            head = code[start:at]
            name = _NAME.search(head)
            if found is None and name and not _SCOPE.search(head):
                first = code.count("\n", 0, at - len(head.lstrip())) + 1
                found, outer = (name.group(1), first), depth
            depth += 1
        elif letter == "}":
            depth -= 1
            if found is not None and depth == outer:
                yield *found, code.count("\n", 0, at) + 2 - found[1]
                found = None
        if letter in "{};" and found is None:
            start = at + 1


def _blank(pattern: re.Pattern[str], text: str) -> str:
    """With spaces for what matches, and the same lines."""
    return pattern.sub(lambda found: re.sub(r"[^\n]", " ", found.group()), text)


@for_each(own_sources(CSRC))
def test_no_function_is_long(path: Path) -> None:
    """Oracle: `LONGEST`."""
    long = [
        f"{name} at line {line}: {lines} lines"
        for name, line, lines in _functions(path.read_text(encoding="utf-8"))
        if lines > LONGEST
    ]
    assert long == []


def test_lengths_are_counted_right() -> None:
    """Oracle: a made-up source, counted by hand."""
    text = """namespace a {
struct S {
    int f() const { return 1; } // }
    template <int N>
    void g() {
        auto h = [&](int i) {
            return i;
        };
    }
};
static int table[] = {1, 2};
#define M(x) { \\
    x
int
long_name(const char *s = "{") {
    if (s) {
    }
    return '}';
}
} // namespace a
"""
    assert list(_functions(text)) == [("f", 3, 1), ("g", 4, 6), ("long_name", 14, 6)]


def test_limits_of_floats_are_no_macros() -> None:
    """Oracle: the text. Those of <cfloat> are missing where zig compiles for macOS, which no test
    here does; std::numeric_limits is there."""
    macro = re.compile(r"\b(?:FLT|DBL)_[A-Z]+\b")
    found = [path.name for path in (CSRC / "src").iterdir() if macro.search(path.read_text())]
    assert found == []


def test_no_exception_crosses_the_interface() -> None:
    """Oracle: the headers: each function with a status does its work inside `guarded`."""
    paths = sorted((CSRC / "include" / "gscore").glob("*.h"))
    headers = "".join(path.read_text(encoding="utf-8") for path in paths)
    stated = set(re.findall(r"^GS_API gs_status (gs_\w+)\(", headers, flags=re.MULTILINE))
    sources = "".join(path.read_text(encoding="utf-8") for path in (CSRC / "src").glob("api*.cpp"))
    guarded = set(re.findall(r'\bguarded\("(gs_\w+)"', sources))
    assert stated - guarded == {"gs_raster_stats"}  # it only copies a struct
    assert guarded <= stated
