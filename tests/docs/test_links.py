"""The text files of the repository; oracle: the files and headings that links name, and columns."""

import re
from functools import cache
from pathlib import Path
from urllib.parse import unquote

from tests.for_each import for_each

ROOT = Path(__file__).parents[2]
_FOLDERS = ("", "docs", "docs/experiments", "examples", "addon", "csrc", "tests", "tests/raster")
PAGES = sorted(
    {page for folder in _FOLDERS for page in (ROOT / folder).glob("*.md")}
    | {page for folder in ("docs", "examples", "tests") for page in (ROOT / folder).rglob("*.md")}
)
WIDEST = 120
_FENCED = re.compile(r"^(```|~~~).*?^\1\s*$", re.M | re.S)
_CODE = re.compile(r"(`+)[^`].*?\1", re.S)
_LINK = re.compile(r"\]\(\s*<?([^)\s>]+)>?(?:\s+\"[^\"]*\")?\s*\)")
_LOOSE = re.compile(r"^\[[^\]]+\]:\s*(\S+)", re.M)
_HTML = re.compile(r"(?:href|src)=\"([^\"]+)\"")
_HEADING = re.compile(r"^#{1,6} +(.+?)\s*#*$", re.M)
_NAMED = re.compile(r"(?:id|name)=\"([^\"]+)\"")


def links(text: str) -> list[str]:
    """Targets of the links and pictures of a page, those in code left out."""
    text = _CODE.sub("", _FENCED.sub("", text))
    return _LINK.findall(text) + _LOOSE.findall(text) + _HTML.findall(text)


def anchors(text: str) -> set[str]:
    """Names of the headings as GitHub makes them, and those stated in HTML."""
    found: set[str] = set()
    for heading in _HEADING.findall(_FENCED.sub("", text)):
        plain = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        name = re.sub(r"[^\w\- ]", "", plain).replace(" ", "-")
        again = (f"{name}-{n}" for n in range(1, 100))
        found.add(name if name not in found else next(a for a in again if a not in found))
    return found | set(_NAMED.findall(text))


@cache
def anchors_of(page: Path) -> set[str]:
    """`anchors` of a file."""
    return anchors(page.read_text(encoding="utf-8"))


def broken(page: Path) -> list[str]:
    """The links of a page that lead nowhere in this repository."""
    wrong = []
    for target in links(page.read_text(encoding="utf-8")):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = unquote(target).partition("#")
        file = (page.parent / path).resolve() if path else page
        inside = file.is_relative_to(ROOT)
        if not (inside and file.exists()) or (anchor and anchor not in anchors_of(file)):
            wrong.append(target)
    return wrong


def too_wide(text: str) -> list[str]:
    """Lines of prose and code wider than they may be; tables, pictures and targets of links are
    not prose."""
    return [
        f"{number}: {line[:60]}... ({len(line)})"
        for number, line in enumerate(text.splitlines(), 1)
        if not line.startswith(("|", "![")) and len(_unlinked(line)) > WIDEST
    ]


def _unlinked(line: str) -> str:
    """A line with its links' targets left out: readers do not see them."""
    return re.sub(r"\]\([^)]*\)", "]", re.sub(r"<?https?://\S+", "", line))


@for_each(PAGES)
def test_links_lead_somewhere(page: Path) -> None:
    """Oracle: the files, and the names GitHub gives to headings."""
    assert broken(page) == []


@for_each(PAGES)
def test_text_is_wrapped(page: Path) -> None:
    """Oracle: the length of the lines."""
    assert too_wide(page.read_text(encoding="utf-8")) == []


def test_every_page_of_the_docs_can_be_reached() -> None:
    """Oracle: the links, followed from the README."""
    seen, ahead = set(), [ROOT / "README.md"]
    while ahead:
        page = ahead.pop()
        if page in seen or page.suffix != ".md" or not page.exists():
            continue
        seen.add(page)
        targets = (t.partition("#")[0] for t in links(page.read_text(encoding="utf-8")))
        ahead += [(page.parent / t).resolve() for t in targets if t and ":" not in t]
    assert {page for page in PAGES if page.is_relative_to(ROOT / "docs")} <= seen


def test_checks_find_each_kind_of_fault(tmp_path: Path) -> None:
    """Oracle: a page with one fault of each kind among things that are none."""
    (tmp_path / "there.md").write_text("# A `b` c, d!\n\n# A b c d\n", encoding="utf-8")
    text = (
        "[a](there.md#a-b-c-d) [b](there.md#a-b-c-d-1) [c](#own) `[d](no.md)`\n## Own\n"
        "```\n[e](no.md)\n```\n[![f](no.png)](there.md)\n<img src=\"gone.svg\">\n[g](there.md#no)\n"
        + "| wide " + "x" * 200 + " |\n" + "word " * 30 + "\n[h](https://example.org/" + "y" * 150
        + ")\n"
    )  # fmt: skip
    assert links(text)[3:5] == ["no.png", "there.md"]
    assert links(text)[5:] == ["there.md#no", "https://example.org/" + "y" * 150, "gone.svg"]
    assert anchors_of(tmp_path / "there.md") == {"a-b-c-d", "a-b-c-d-1"}
    assert [line.partition(":")[0] for line in too_wide(text)] == ["10"]
