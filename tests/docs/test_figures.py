"""Figures quoted in texts; oracle: the cells of the tables in which they were measured.

A quote names its page and a pattern with a group for each figure, and for each figure where it was
measured. It fails when the figure changes on either side, when the pattern is no longer found, and
when the table lost its row or column.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from gscore.presets import PRESETS

ROOT = Path(__file__).parents[2]
BENCHMARKS = "docs/benchmarks.md"
EXPERIMENTS = "docs/experiments/2026-11-{}.md"
WORDS = {
    "a quarter of a minute": 15.0,
    "a minute and a quarter": 75.0,
    "two minutes": 120.0,
    "five minutes": 300.0,
    "ten minutes": 600.0,
    "a tenth": 0.1,
}
_NUMBER = re.compile(r"[-+]?\d[\d,]*(?:\.\d+)?")

Source = Callable[[], float]


def _numbers(text: str) -> list[float]:
    return [float(found.replace(",", "")) for found in _NUMBER.findall(text)]


def _tables(page: str, heading: str) -> list[list[list[str]]]:
    """The tables below a heading, as cells without emphasis; the first row holds the columns."""
    text = (ROOT / page).read_text(encoding="utf-8")
    sections = re.split(r"^#+ ", text, flags=re.MULTILINE)
    (section,) = [s for s in sections if s.splitlines()[:1] == [heading]]
    blocks = re.findall(r"(?:^\|.*\n)+", section, flags=re.MULTILINE)
    return [
        [
            [cell.strip().replace("**", "") for cell in row.strip("|").split("|")]
            for i, row in enumerate(block.splitlines())
            if i != 1
        ]
        for block in blocks
    ]


def cell(page: str, heading: str, row: str, column: str, pick: int = 0, nth: int = 0) -> Source:
    """A number of a table.

    Args:
        page: From the root of the repository.
        heading: Of its section, without the signs before it.
        row: How the row begins, its cells joined by ` | `.
        column: Its title.
        pick: Which number of the cell.
        nth: Which of the columns of that title.
    """

    def value() -> float:
        rows = [
            (columns, cells)
            for columns, *body in _tables(page, heading)
            for cells in body
            if column in columns and (" | ".join(cells) + " |").startswith(row + " |")
        ]
        assert len(rows) == 1, f"{page}, {heading!r}: {len(rows)} rows {row!r} with {column!r}"
        columns, cells = rows[0]
        at = [i for i, title in enumerate(columns) if title == column][nth]
        return _numbers(cells[at])[pick]

    return value


def less(a: Source, b: Source) -> Source:
    """a - b."""
    return lambda: a() - b()


def least(*sources: Source) -> Source:
    """The smallest."""
    return lambda: min(source() for source in sources)


def most(*sources: Source) -> Source:
    """The largest."""
    return lambda: max(source() for source in sources)


@dataclass(frozen=True)
class Quote:
    """A place that repeats measured figures."""

    page: str
    pattern: str
    """White space stands for any; a group for each figure, in digits or in `WORDS`."""
    sources: tuple[Source, ...]
    within: float = 0.0
    """Share of the figure that it may be off, besides what rounding to its digits does."""


def _climbed(capture: str) -> Source:
    """What `normal` has more than `draft`."""
    page, column = EXPERIMENTS.format("ladder"), "`normal`: colour-corrected, dB"
    heading = "Quality of the presets" if capture == "all" else "With dropout"
    return cell(page, heading, capture, column)


def _captures(capture: str, column: str) -> Source:
    return cell(BENCHMARKS, "Captures", capture, column)


def _kernels(row: str, column: str) -> Source:
    return cell(BENCHMARKS, "Kernels", row, column)


def _other(row: str, column: str, pick: int = 0) -> Source:
    return cell(BENCHMARKS, "Other programs", row, column, pick)


def _seeds(capture: str) -> tuple[Source, Source, Source]:
    """PSNR of the three seeds of a preview."""
    row, column = f"{capture} | preview", "PSNR (seeds 0, 1, 2)"
    a, b, c = (cell(BENCHMARKS, "Captures", row, column, i) for i in range(3))
    return a, b, c


def _freed(capture: str) -> Source:
    """What free space brings to drafts, dB."""
    page, heading = EXPERIMENTS.format("free-space"), "Free space in front of cameras (2026-11-22)"
    without = cell(page, heading, capture, "`--free-space 0`: PSNR (by seed)")
    return less(cell(page, heading, capture, "0.4: PSNR"), without)


def _coupled(capture: str) -> Source:
    """What growth with the photos brings to drafts, dB."""
    page, heading = EXPERIMENTS.format("small-photos"), "Comparison with immediate growth"
    without = cell(page, heading, capture, "immediate: PSNR (by seed)")
    return less(cell(page, heading, capture, "with the photos: PSNR"), without)


def _depth(row: str, heading: str = "Real captures") -> Source:
    """What simulated network depth brings, colour-corrected, dB."""
    page = EXPERIMENTS.format("depth")
    return cell(page, heading, f"{row} | simulated network", "colour-corrected")


def _before(row: str, column: str) -> Source:
    page = EXPERIMENTS.format("presets")
    return cell(
        page, "Presets without free space and with growth at once (2026-11-22)", row, column
    )


def _pruned(options: str) -> Source:
    page, heading = EXPERIMENTS.format("growth"), "Growth and pruning (2026-11-21)"
    return cell(page, heading, f"plush | {options}", "PSNR")


_GROWING = "`-n 2000 --densify-until 2000`: grows at 1,000 and 1,500"
_GROWING_MORE = (
    "`-n 1000 --densify-from 99 --refine-every 100 --densify-until 1000`: grows nine times"
)
_OPENSPLAT = "Step time compared with OpenSplat (2026-11-21)"
_STEPS = ("steps 6 to 30", "steps 61 to 106", "steps 61 to 106, the same")
_PLUSH = "plush, 800 x 600"
_TIMES = tuple(cell(EXPERIMENTS.format("opensplat"), _OPENSPLAT, s, "times") for s in _STEPS)

_PRESET_SECONDS = (
    _captures("studio | preview", "train s"),
    _captures("plush | draft, 640 x 480 px", "train s"),
    _before("plush | normal, 800 x 600 px", "train s"),
    _before("plush | high, 800 x 600 px", "train s"),
)
QUOTES = (
    Quote("README.md", r"its training takes (\d+) s", (_captures("studio | preview", "train s"),)),
    Quote(
        "README.md",
        r"reaches ([\d.]+) to ([\d.]+) dB on ten held-out views",
        (least(*_seeds("studio")), most(*_seeds("studio"))),
    ),
    Quote(
        "README.md",
        r"reaches ([\d.]+) to ([\d.]+) dB on the held-out ones after (\d+) s",
        (
            least(*_seeds("plush")),
            most(*_seeds("plush")),
            _captures("plush | preview", "train s"),
        ),
    ),
    Quote(
        "README.md",
        r"after (\d+) and (\d+) s, it takes ([\d.]+) and ([\d.]+) s",
        (
            _other(_GROWING_MORE, "seconds"),
            _other(_GROWING, "seconds"),
            _other(_GROWING_MORE, "gscore, seeds 0, 1, 2", 1),
            _other(_GROWING, "gscore, seeds 0, 1, 2", 2),
        ),
        within=0.01,
    ),
    Quote(
        "README.md",
        r"510 x 510 px take (two minutes)",
        (_captures("stone_horse | normal, full size", "train s"),),
        within=0.05,
    ),
    Quote(
        "README.md",
        r"evaluate ([\d.]+) billion .*? at (\d+) frames a second .* "
        r"AVX2 it is ([\d.]+) billion and (\d+)",
        (
            _kernels(f"{_PLUSH} | AVX-512 | 2", "Gpair/s, blending"),
            _kernels(f"{_PLUSH} | AVX-512 | 2", "forward fps"),
            _kernels(f"{_PLUSH} | AVX2 | 2", "Gpair/s, blending"),
            _kernels(f"{_PLUSH} | AVX2 | 2", "forward fps"),
        ),
    ),
    Quote(
        "README.md",
        r"a first look \| (a quarter of a minute) .* capture \| (a minute and a quarter) .* "
        r"results \| (five minutes) .* gives \| (ten minutes) to an hour",
        _PRESET_SECONDS,
        within=0.15,
    ),
    Quote(
        "gscore/presets.py",
        r"about (15) s .* about (75) s .* about (five minutes) .* quality, in (ten minutes) to an "
        r"hour",
        _PRESET_SECONDS,
        within=0.15,
    ),
    Quote(
        "CHANGELOG.md",
        r"A preview of 59 photos takes (\d+) s",
        (_captures("plush | preview", "train s"),),
    ),
    Quote(
        "CHANGELOG.md",
        r"50,000 splats at (\d+) frames a second",
        (_kernels(f"{_PLUSH} | AVX-512 | 2", "forward fps"),),
    ),
    Quote(
        BENCHMARKS,
        r"([\d.]+) dB on drafts of studio, ([\d.]+) on plush, ([\d.]+) on lund",
        (_freed("studio"), _freed("plush"), _freed("lund")),
    ),
    Quote(EXPERIMENTS.format("ladder"), r"it gained ([\d.]+) dB over drafts", (_climbed("all"),)),
    Quote(
        "docs/experiments/README.md",
        r"`normal` is ([\d.]+) to ([\d.]+) dB better than `draft`",
        (_climbed("plush"), _climbed("garden")),
    ),
    Quote(
        EXPERIMENTS.format("small-photos"),
        r"raise drafts by another ([\d.]+) to ([\d.]+) dB",
        (_coupled("stone_horse"), _coupled("plush")),
    ),
    Quote(
        EXPERIMENTS.format("free-space"),
        r"raises drafts of studio by ([\d.]+) dB, of plush by ([\d.]+) and of lund by ([\d.]+);",
        (_freed("studio"), _freed("plush"), _freed("lund")),
    ),
    Quote(
        BENCHMARKS,
        r"gscore is (\d+) to (\d+) times as fast a step",
        (least(*_TIMES), most(*_TIMES)),
    ),
    Quote(
        "docs/budgets.md",
        r"with 0\.5 (a tenth) of a decibel",
        (less(_pruned("none"), _pruned("`--prune-share 0.5`")),),
        within=0.15,
    ),
    Quote(
        "docs/depth.md",
        r"\| 6 \| \*\*(\S+)\*\* \(plush\), \*\*(\S+)\*\* \(stone_horse\), studio (\S+) in small",
        (_depth("plush, 6"), _depth("stone_horse, 6"), _depth("6", "Few views and many")),
    ),
    Quote(
        "docs/depth.md",
        r"in the median: studio (\S+), plush (\S+) ",
        (_depth("studio, 24"), _depth("plush, 24")),
    ),
    Quote(
        "docs/depth.md",
        r"studio (\S+) in small runs, (\S+) at full size",
        (
            _depth("50", "Few views and many"),
            _depth("50", "Full size, 50 training and 10 test views"),
        ),
    ),
)


@pytest.mark.parametrize("quote", QUOTES, ids=lambda q: f"{Path(q.page).name}: {q.pattern[:40]}")
def test_quoted_figures_are_the_measured_ones(quote: Quote) -> None:
    """Oracle: the cells that `QUOTES` names, rounded to the digits of the quote."""
    text = " ".join((ROOT / quote.page).read_text(encoding="utf-8").split())
    found = re.search(quote.pattern.replace("\n", " "), text)
    assert found, f"{quote.page} has no {quote.pattern!r} any more: mend the list or the page"
    assert len(found.groups()) == len(quote.sources)
    for said, source in zip(found.groups(), quote.sources, strict=True):
        value, measured = WORDS.get(said), source()
        digits = 0.0
        if value is None:
            (value,) = _numbers(said)
            digits = 0.5 * 10.0 ** -len(said.partition(".")[2].rstrip("*."))
        off = abs(value - measured)
        assert off <= digits + quote.within * abs(value) + 1e-9, f"{said!r}: measured {measured:g}"


def test_presets_are_those_of_the_readme() -> None:
    """Oracle: `PRESETS`; the README's table has their steps, splats and widths."""
    rows = [
        row
        for table in _tables("README.md", "Presets")
        for row in table[1:]
        if row[0].strip("`") in PRESETS
    ]
    assert [row[0].strip("`") for row in rows] == list(PRESETS)
    for name, *_, steps, splats, width in rows:
        data, train = PRESETS[name.strip("`")](Path())
        assert _numbers(steps) == [train.iterations]
        assert _numbers(splats) == [train.max_splats]
        assert _numbers(width) == [data.max_width]
