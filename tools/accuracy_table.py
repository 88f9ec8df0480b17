"""The table of docs/accuracy.md from `gscore stress --json`: the worst error of each test.

`gscore stress --json --isa all > found.json; python tools/accuracy_table.py found.json`
"""

import json
import sys
from pathlib import Path


def main() -> int:
    """Print one row a test: tolerance, worst error, instruction set."""
    worst: dict[str, dict] = {}
    for file in sys.argv[1:]:
        for row in json.loads(Path(file).read_text()):
            old = worst.get(row["test"])
            if old is None or (row["error"] or 0) > (old["error"] or 0):
                worst[row["test"]] = row
    groups: dict[str, list[dict]] = {}
    for row in worst.values():
        title, _, what = row["test"].partition(": ")
        groups.setdefault(title, []).append({**row, "what": what})
    print("| test | what | tolerance | worst error |")
    print("|---|---|---|---|")
    for title in sorted(groups):
        for number, row in enumerate(groups[title]):
            exact = row["tolerance"] == 0
            error = "0" if row["error"] == 0 else _short(row["error"])
            mark = "" if row["passed"] else " **failed**" if row["passed"] is False else " skipped"
            tolerance = "0" if exact else _short(row["tolerance"])
            print(
                f"| {title if number == 0 else ''} | {row['what']} | {tolerance} | {error}{mark} |"
            )
    return 0


def _short(value: float | None) -> str:
    return "" if value is None else f"{value:.1e}".replace("e-0", "e-").replace("e+0", "e")


if __name__ == "__main__":
    raise SystemExit(main())
