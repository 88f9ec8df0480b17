"""The depth experiment's tables: what each arm reached, and whether it would become a default."""

import statistics
from collections.abc import Sequence
from typing import Any

from gscore.bench.paired import Difference
from gscore.bench.quality import Comparison, ScoredView, Training, compare
from gscore.text_format import markdown_table

_Arms = dict[str, dict[int, dict[str, Any]]]
"""By arm and seed: what `compare.main` wrote of a run."""


def tables(rows: list[dict[str, Any]], arms: Sequence[str]) -> str:
    """Markdown: a row an arm, and the rule of docs/quality.md for each number of views.

    Figures are means and standard deviations over seeds. The gain is over no depth, seed by seed;
    colour-corrected is the median over views and seeds of that, with its 95 % interval.

    Args:
        rows: What `compare.main` wrote of each run.
        arms: All arms, in the order of the table.
    """
    settings: dict[str, dict[tuple[str, int], _Arms]] = {}
    for row in rows:
        group = settings.setdefault(row["setting"], {}).setdefault(
            (row["capture"], row["views"]), {}
        )
        group.setdefault(row["arm"], {})[row["seed"]] = row
    lines: list[str] = []
    for setting, groups in sorted(settings.items()):
        cells = [
            [capture, str(count), arm, *_cells(found, arm)]
            for (capture, count), found in sorted(groups.items())
            for arm in sorted(found, key=list(arms).index)
        ]
        lines += ["", f"{setting}:", "", markdown_table(_HEAD, cells)]
        lines += ["", markdown_table(_RULE_HEAD, _rule(rows, setting, arms))]
    return "\n".join(lines).strip() + "\n"


_HEAD = ("capture", "views", "arm", "seeds", "PSNR", "gain in PSNR", "colour-corrected", "SSIM")
_HEAD += ("LPIPS", "depth error", "where seen", "known", "CPU s")
_RULE_HEAD = ("views", "arm", "captures", "colour-corrected", "default by the rule")


def _cells(arms: _Arms, arm: str) -> list[str]:
    """What one arm of a capture with one number of views reached."""
    found, base = arms[arm], arms.get(_base(arm), {})
    pairs = [(row, base[seed]) for seed, row in found.items() if seed in base]
    gain = corrected = ""
    if base is not found and pairs:
        if all(row["splats_sha256"] == other["splats_sha256"] for row, other in pairs):
            gain = "same splats"
        else:
            gain = _mean_text([row["psnr"] - other["psnr"] for row, other in pairs], 2, sign="+")
            corrected = _corrected(list(found.values()), list(base.values()), arm)
    return [
        *(str(len(found)), _spread_text(found, "psnr", 2), gain, corrected),
        *(_spread_text(found, key, 3) for key in ("ssim", "lpips")),
        *(_spread_text(found, key, 3) for key in ("depth_error", "depth_error_seen", "known")),
        _spread_text(found, "cpu_seconds", 0),
    ]


def _base(arm: str) -> str:
    """What an arm is compared with."""
    return "masked" if arm.startswith("masked") else "none"


def _corrected(found: list[dict[str, Any]], base: list[dict[str, Any]], arm: str) -> str:
    compared = _compared([*found, *base], arm)
    return "n/a" if compared is None else _interval(compared.psnr_cc)


def _rule(rows: list[dict[str, Any]], setting: str, arms: Sequence[str]) -> list[list[str]]:
    """Whether an arm would become a default for so many views, over all captures that have it."""
    lines = []
    mine = [row for row in rows if row["setting"] == setting]
    for asked in dict.fromkeys(row["asked"] for row in sorted(mine, key=lambda row: row["views"])):
        some = [row for row in mine if row["asked"] == asked]
        for arm in arms:
            compared = None if arm == _base(arm) else _compared(some, arm)
            if compared is not None:
                captures, verdict = ", ".join(compared.captures), compared.verdict
                words = f"{'yes' if verdict.accepted else 'no'}: {verdict.why}"
                cells = [asked, arm, captures, _interval(compared.psnr_cc), words]
                lines.append(cells)
    return lines


def _compared(rows: list[dict[str, Any]], arm: str) -> Comparison | None:
    return compare([_training(row) for row in rows], _base(arm), arm)


def _training(row: dict[str, Any]) -> Training:
    """A run as `gscore bench quality` knows it."""
    return Training(
        capture=row["capture"],
        variant=row["arm"],
        seed=row["seed"],
        offset=0,
        seconds=row["cpu_seconds"],
        splats=row["splats"],
        gap=None,
        views=tuple(ScoredView(**view) for view in row["judged"]),
    )


def _interval(found: Difference) -> str:
    return f"{found.median:+.2f} ({found.low:+.2f} to {found.high:+.2f})"


def _spread_text(rows: dict[int, dict[str, Any]], key: str, digits: int) -> str:
    return _mean_text([row[key] for row in rows.values() if row[key] is not None], digits)


def _mean_text(values: list[float], digits: int, *, sign: str = "") -> str:
    if not values:
        return "n/a"
    mean = f"{statistics.fmean(values):{sign}.{digits}f}"
    return f"{mean} ± {statistics.stdev(values):.{digits}f}" if len(values) > 1 else mean
