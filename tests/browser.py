"""Debian's Chromium without a window, for tests of pages; without it they are skipped."""

import shutil
import subprocess
from pathlib import Path

import pytest

_WATCH = """<script>
addEventListener("error", (e) => document.documentElement.dataset.failed = e.message);
</script>
"""


def page_after(path: Path, *, act: str = "", width: int = 1200, height: int = 900) -> str:
    """The tree of a page as HTML, once its scripts have run.

    Args:
        path: The page.
        act: JavaScript that is run after them, as a reader would act.
        width: Of the window, px.
        height: Of the window, px.
    """
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        pytest.skip("needs chromium")
    text = path.read_text(encoding="utf-8")
    watched = path.with_name(f"watched_{path.name}")
    text = text.replace("<head>", f"<head>{_WATCH}", 1)
    watched.write_text(text.replace("</body>", f"<script>{act}</script></body>"), "utf-8")
    words = ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=3000"]
    done = subprocess.run(
        [program, *words, f"--window-size={width},{height}", "--dump-dom", watched.as_uri()],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr[-500:]
    assert "data-failed" not in done.stdout.partition("<body")[0], done.stdout[:300]
    return done.stdout
