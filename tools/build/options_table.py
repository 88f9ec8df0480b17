"""Options table, docs/options.md, from the declarations: `python tools/build/options_table.py`."""

from itertools import groupby
from pathlib import Path

from gscore.commands.args.option_names_3dgs import rows
from gscore.commands.args.run_options import preset_values
from gscore.commands.options import all_options, idle_when
from gscore.options import Option

PAGE = Path(__file__).parents[2] / "docs" / "options.md"
_HEAD = """# Options of a training

`gscore train --help` shows the options that matter most, in bold here. All are given under their
long flags (`--lr-boost 2`, `--no-watchdog`) or by name, `--set lr_boost=2`, which may be
repeated; several values are joined by commas there. `gscore options opacity` lists those with a
word in name or text, `--json` gives programs all that is known. In Python they are the fields of
`gscore.TrainConfig` and `gscore.DataConfig`, and in config.json they have the same names.

An extent is 1.1 times the largest distance of a camera from the middle of all. SH (spherical
harmonics) are the view-dependent colour, SfM points those that COLMAP found; to refine is to add
and remove splats. Learning rates are raised in runs of less than 30,000 steps and fall over the
last tenth of any; `--set lr_boost=1 --set lr_final=1` takes them exactly as given.

This page is made by `tools/build/options_table.py` from `gscore/config.py` and `gscore/presets.py`.
"""
_NAMES = """
## Names of 3DGS

Scripts for the original 3DGS may keep these, with underscores or dashes:

| there | here |
|---|---|
"""


def page() -> str:
    """The whole page."""
    parts = [_HEAD]
    for group, members in groupby(all_options(), key=lambda one: one.group):
        parts.append(f"\n## {group[0].upper()}{group[1:]}\n\n")
        parts.append("| option | default | takes | unit | what it does |\n|---|---|---|---|---|\n")
        parts += [_row(one) for one in members]
    names = [f"| `{row.name}` | {row.here} |\n" for row in rows()]
    return "".join([*parts, _NAMES, *names])


def _row(one: Option) -> str:
    name = f"`{one.name}`"
    value = preset_values(one) or one.default_words
    shown = f"**{name}**" if one.basic else name
    cells = (shown, value, one.values, one.unit, one.text + idle_when(one))
    return f"| {' | '.join(cells)} |\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
