"""docs/options.md; oracle: what tools/build/options_table.py makes of the declarations."""

import sys
from dataclasses import fields

from gscore.config import TrainConfig
from tests.docs.test_links import ROOT

sys.path.insert(0, str(ROOT / "tools" / "build"))

from options_table import PAGE, page


def test_the_page_is_up_to_date() -> None:
    """Oracle: the page made anew; run tools/build/options_table.py after a change of an option."""
    assert PAGE.read_text(encoding="utf-8") == page()


def test_every_option_has_a_row() -> None:
    """Oracle: the fields of TrainConfig, and as many cells in each row as in the head."""
    lines = page().splitlines()
    rows = [line for line in lines if line.startswith(("| `", "| **`"))]
    for field in fields(TrainConfig):
        assert sum(f"`{field.name}`" in row.split("|")[1] for row in rows) == 1, field.name
    assert {line.count("|") for line in rows} == {3, 6}
