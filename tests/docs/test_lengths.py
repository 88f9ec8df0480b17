"""Pages stay short enough to be read; oracle: how many lines they may have."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("page", ["docs/benchmarks.md", "docs/depth.md"])
def test_results_and_how_tos_are_short(page: str) -> None:
    """Oracle: 150 lines; what was tried goes to docs/experiments/, a method to its own page."""
    assert len((ROOT / page).read_text(encoding="utf-8").splitlines()) <= 150


def test_the_newest_changes_take_a_few_lines() -> None:
    """Oracle: 15 lines besides headings, of what a user has."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    newest = text.split("\n## ")[1].splitlines()[1:]
    assert 1 <= len([line for line in newest if line.strip()]) <= 15
