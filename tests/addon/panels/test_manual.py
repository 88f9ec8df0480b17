"""Help. Oracle: Blender's own manual lookup for a button or a field, and the manual's headings."""

import re
import webbrowser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import bl_operators.wm
import bpy
import pytest

from addon.panels import manual as shown
from tests.addon.captures import ROOT
from tools.build.manual_page import PAGES, anchor, manual, manual_page

DOCS = ROOT / "docs"
MARKDOWN = "".join((DOCS / page).read_text(encoding="utf-8") for page in PAGES)


def headings(markdown: str) -> list[str]:
    """Their anchors."""
    without_code = re.sub(r"(?ms)^```.*?^```", "", markdown)
    return [anchor(title) for title in re.findall(r"(?m)^#+ (.*)$", without_code)]


def looked_up(name: str) -> str:
    """URL that *Online Manual* opens."""
    return bl_operators.wm.WM_OT_doc_view_manual._lookup_rna_url(name, verbose=False)


@pytest.mark.parametrize("installed", [False, True])
@pytest.mark.parametrize(
    ("name", "page", "section"),
    [
        ("bpy.ops.gscore.train", "training", "train"),
        ("bpy.ops.gscore.find_cameras", "cameras", "capture"),
        ("bpy.ops.gscore.import_cameras", "cameras", "cameras"),
        ("bpy.ops.gscore.import_splats", "splats", "result"),
        ("bpy.ops.gscore.compare_photo", "rendering", "render"),
        ("bpy.ops.gscore.paint_mask", "steering", "steer-training"),
        ("bpy.ops.gscore.grade_splats", "editing", "edit"),
        ("bpy.ops.gscore.paint_splats", "editing", "paint"),
        ("bpy.types.BrushSettings.radius", "editing", "paint"),
        ("bpy.ops.gscore.make_environment", "install", "install"),
        ("bpy.ops.gscore.measure_errors", "splats", "error-maps"),
        ("bpy.types.SequenceSettings.speed", "sequences", "sequences"),
    ],
)
def test_buttons_and_fields_have_their_place(
    name: str,
    page: str,
    section: str,
    installed: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Oracle: the pages of a checkout and their headings; the one page of the extension."""
    expected = DOCS / "blender" / f"{page}.md"
    assert section in headings(expected.read_text(encoding="utf-8"))
    if installed:
        expected = tmp_path / "manual.html"
        expected.write_text(manual_page(manual(DOCS)), encoding="utf-8")
        monkeypatch.setattr(shown, "_INSTALLED", expected)
    found = urlsplit(looked_up(name))
    assert (Path(unquote(found.path)), found.fragment) == (expected, section)


def test_everything_of_the_addon_is_in_it() -> None:
    """Oracle: the add-on's operators, and the sections of the map."""
    for verb in dir(bpy.ops.gscore):
        assert looked_up(f"bpy.ops.gscore.{verb}"), verb
    for _, place in shown.manual_map()[1]:
        page, _, section = place.partition("#")
        assert section in headings((DOCS / page[1:]).read_text(encoding="utf-8")), place
    assert looked_up("bpy.ops.object.delete").startswith("https://docs.blender.org/")


def test_the_button_opens_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the URL passed to the browser; an error if the page is missing."""
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    assert bpy.ops.gscore.open_manual() == {"FINISHED"}
    assert opened == [shown.page().as_uri()]
    monkeypatch.setattr(shown, "_DOCS", Path("/gone"))
    with pytest.raises(RuntimeError, match="install the add-on again"):
        bpy.ops.gscore.open_manual()


def test_the_page_has_all_of_the_manual() -> None:
    """Oracle: headings, words and tables of the Markdown, with unique headings; no link leaves the
    page, and those between pages link to headings."""
    wanted = headings(MARKDOWN)
    assert len(set(wanted)) == len(wanted)
    page = manual_page(manual(DOCS))
    assert re.findall(r'<h[1-6] id="([^"]*)"', page) == wanted
    assert page.count("<table>") == len(re.findall(r"(?m)^\s*\|[-:| ]+\|$", MARKDOWN))
    assert page.count("<pre>") == MARKDOWN.count("```") // 2
    links = re.findall(r'href="([^"]*)"', page)
    assert all(link.startswith(("#", "https://")) for link in links)
    assert {link[1:] for link in links if link.startswith("#")} <= set(wanted)
    names = "|".join(Path(page).stem for page in PAGES)
    between = re.findall(rf"\]\((?:blender/)?(?:{names})\.md#([^)]*)\)", MARKDOWN)
    assert between and {f"#{name}" for name in between} <= set(links)
    assert "<img" not in page and "![" not in page and "**" not in page
