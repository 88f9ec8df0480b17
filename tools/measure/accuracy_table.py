"""Accuracy table of docs/accuracy-tests.md: worst errors, tolerances of `gscore stress --json`.

`gscore stress --json --isa all > found.json; python tools/measure/accuracy_table.py found.json`
"""

import json
import sys
from pathlib import Path


def main() -> int:
    """Print a row for each test and tolerance, with its worst measure."""
    rows = [row for file in sys.argv[1:] for row in json.loads(Path(file).read_text())]
    groups: dict[tuple[str, float | None], list[dict]] = {}
    for row in rows:
        title, _, what = row["test"].partition(": ")
        groups.setdefault((title, row["tolerance"]), []).append({**row, "what": what})
    print("| test | worst of | tolerance | error |")
    print("|---|---|---|---|")
    before = ""
    for (title, tolerance), found in groups.items():
        worst = max(found, key=lambda row: float("inf") if row["error"] is None else row["error"])
        count = len({row["what"] for row in found})
        what = worst["what"] if count == 1 else f"{count} measures: {worst['what']}"
        if tolerance == 0 and worst["error"] == 0:
            what = worst["what"] if count == 1 else f"{count} counts"
        bad = [row for row in found if row["passed"] is False]
        state = f" **{len(bad)} failed**" if bad else "" if worst["passed"] else " skipped"
        name = "" if title == before else title
        print(f"| {name} | {what} | {_short(tolerance)} | {_short(worst['error'])}{state} |")
        before = title
    return 0


def _short(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:g}" if value == 0 or 0.01 < value < 1e4 else f"{value:.1e}".replace("e-0", "e-")


if __name__ == "__main__":
    raise SystemExit(main())
