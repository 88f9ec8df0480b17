"""Page link: embeds view.html, the page with the splats, in report.html."""

from pathlib import Path

from ..io.files import atomic_write, read_bytes

PAGE = "view.html"
"""Default page of `gscore view` in the folder of a run."""
SEAM = "<!-- gscore view -->"
"""Placeholder for the page in a report."""
_SHOWN = (
    f'{SEAM}<section id="page"><h2><a href="{PAGE}">Look around in 3D</a></h2>'
    "<details><summary>Show it here</summary>"
    f'<iframe src="{PAGE}" title="The splats" loading="lazy"></iframe></details></section>\n'
)


def link_page(folder: Path) -> bool:
    """Embed view.html in the report.html of a folder; returns False if there is no report with a
    placeholder.

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
