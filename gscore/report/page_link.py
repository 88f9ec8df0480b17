"""Page link: the place in report.html for the page with the splats, once one exists."""

from pathlib import Path

from ..io.files import atomic_write, read_bytes

PAGE = "view.html"
"""Name of the page that `gscore view` writes into the folder of a run."""
SEAM = "<!-- gscore view -->"
"""In a report: here the page would be shown."""
_SHOWN = (
    f'{SEAM}<section id="page"><h2><a href="{PAGE}">Look around in 3D</a></h2>'
    "<details><summary>Show it here</summary>"
    f'<iframe src="{PAGE}" title="The splats" loading="lazy"></iframe></details></section>\n'
)


def link_page(folder: Path) -> bool:
    """Show view.html in the report.html beside it; whether there is a report that has a place for
    it.

    Raises:
        GsError: the report cannot be written.
    """
    report = folder / "report.html"
    if not (report.is_file() and (folder / PAGE).is_file()):
        return False
    content = read_bytes(report)
    shown, seam = _SHOWN.encode(), SEAM.encode()
    if shown not in content and content.count(seam) == 1:
        atomic_write(report, content.replace(seam, shown))
    return shown in content or content.count(seam) == 1
