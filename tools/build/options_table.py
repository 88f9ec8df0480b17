"""Options table, docs/options.md, from the declarations: `python tools/build/options_table.py`."""

from itertools import groupby
from pathlib import Path

from gscore.commands.args.option_names_3dgs import rows
from gscore.commands.args.run_options import preset_values
from gscore.commands.options import all_options, effect_condition
from gscore.options import Option

PAGE = Path(__file__).parents[2] / "docs" / "options.md"
_HEAD = """# Options of a training

`gscore train --help` shows the most important options, in bold here. Set any option by its long
flag (`--lr-boost 2`, `--no-watchdog`) or by name with the repeatable `--set lr_boost=2`, where
commas separate several values. `gscore options opacity` lists the options with a word in name or
text; `--json` prints all properties. The same names are fields of `gscore.TrainConfig` and
`gscore.DataConfig` in Python, and keys in config.json.

An extent is 1.1 times the largest distance of a camera from the mean of all. SH (spherical
harmonics) encode the view-dependent colour; SfM points are those of COLMAP; refinement adds and
removes splats. Learning rates are raised in runs of less than 30,000 steps and decay over the
last tenth of every run; `--set lr_boost=1 --set lr_final=1` uses them exactly as given.

`tools/build/options_table.py` generates this page from `gscore/config.py` and `gscore/presets.py`.
"""
_NAMES = """
## Names of 3DGS

Accepted for scripts of the original 3DGS, with underscores or dashes:

| there | here |
|---|---|
"""


def page() -> str:
    """The page as Markdown."""
    parts = [_HEAD]
    for group, members in groupby(all_options(), key=lambda one: one.group):
        parts.append(f"\n## {group[0].upper()}{group[1:]}\n\n")
        parts.append("| option | default | values | unit | effect |\n|---|---|---|---|---|\n")
        parts += [_row(one) for one in members]
    names = [f"| `{row.name}` | {row.here} |\n" for row in rows()]
    return "".join([*parts, _NAMES, *names])


def _row(one: Option) -> str:
    name = f"`{one.name}`"
    value = preset_values(one) or one.default_text
    shown = f"**{name}**" if one.basic else name
    cells = (shown, value, one.values, one.unit, one.text + effect_condition(one))
    return f"| {' | '.join(cells)} |\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
