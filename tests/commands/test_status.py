"""The status line: it fits any terminal, and leaves no rest."""

import contextlib
import io
import os
import pty
import re
import sys
from itertools import product

import pytest

from gscore.commands.terminal import status
from gscore.commands.terminal.display import Lines
from gscore.commands.terminal.status import Counted, Status, cells, line_within, wrapped
from gscore.events import Done, SfmDone
from tests.commands.screen import drawn, gscore, resize, run_in_terminal
from tests.for_each import for_each

PARTS = ["1:02:03 left", "step 14,878 of 15,000", "PSNR 28.8 dB", "431,526 splats", "53.4 steps/s"]


@for_each(product([*range(1, 121), 200, 300], [None, 0.0, 0.597, 1.0]))
def test_a_line_of_any_width(width: int, share: float | None) -> None:
    """Oracle: the width; the first parts, each in full."""
    text = line_within(PARTS, share, width)
    assert 0 < cells(text) <= width
    if share is None and width >= len(PARTS[0]):
        assert text == "  ".join(PARTS[: text.count("  ") + 1])
    if share is not None and width >= 30:
        bar, percent, *rest = re.split(r"  +", text)
        inner = bar.strip("[]")
        assert percent == f"{int(100 * share)}%" and rest == PARTS[: len(rest)]
        assert len(bar) <= 30 and inner.count("#") == int(share * len(inner))
    if share is not None and width >= 99:
        assert text.endswith(PARTS[-1])


def test_wide_letters_count_twice() -> None:
    """Oracle: the Unicode standard's East Asian widths."""
    assert cells("é") == 1 and cells("e\u0301") == 1 and cells("写真") == 4
    assert cells(line_within(["写真" * 30], None, 39)) == 38


class Terminal(io.TextIOWrapper):
    """The near end of a pseudo-terminal as a stream, read while it is written, because its buffer
    is small."""

    def __init__(self, columns: int, encoding: str = "utf-8") -> None:
        self._far, near = pty.openpty()
        os.set_blocking(self._far, False)
        resize(near, columns)
        self._received = b""
        raw = os.fdopen(near, "wb", buffering=0)
        super().__init__(raw, encoding=encoding, errors="strict", write_through=True)

    def write(self, text: str) -> int:
        count = super().write(text)
        with contextlib.suppress(BlockingIOError):
            self._received += os.read(self._far, 1 << 16)
        return count

    def said(self) -> str:
        """The output since the last call."""
        received, self._received = self._received, b""
        return received.decode(self.encoding)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The clock of the module; a second passes at each reading."""
    now = [0.0]

    def look() -> float:
        now[0] += 1.0
        return now[0]

    monkeypatch.setattr(status.time, "monotonic", look)
    monkeypatch.setenv("TERM", "xterm")
    return now


@pytest.mark.parametrize("columns", [40, 80, 132, 300])
def test_a_terminal_stays_tidy(columns: int, clock: list[float]) -> None:
    """Oracle: a terminal emulator: two permanent lines, one moving line, and no rest."""
    terminal = Terminal(columns)
    line = Status(terminal)
    line.print_line("first")
    for step in range(200):
        line.show([f"{200 - step} s left", *PARTS[1:]], share=step / 200)
    line.print_line("second")
    line.show(["a last look"], share=1.0)
    text = terminal.said()
    assert [row.split()[0] for row in drawn(text, columns)] == [
        "first",
        "second",
        "[" + "#" * 28 + "]",
    ] or (columns == 40)
    assert len(drawn(text, columns)) == 3
    line.clear()
    assert drawn(text + terminal.said(), columns) == ["first", "second"]


def test_a_terminal_that_is_resized(clock: list[float]) -> None:
    """Oracle: the width of the terminal at the moment of each output, and room for ^C at the
    end."""
    terminal = Terminal(100)
    line = Status(terminal)
    for columns in (100, 60, 40, 300, 20, 80):
        resize(terminal.fileno(), columns)
        for step in range(5):
            line.show(PARTS, share=step / 5)
            parts = terminal.said().split("\r")
            assert all(len(part) + len("^C") < columns for part in parts)


@pytest.mark.parametrize("term", ["dumb", None])
def test_output_that_is_not_a_terminal(
    term: str | None, clock: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: whole lines, none before ten seconds, then one in ten seconds; no \r, no bar."""
    stream = io.StringIO()
    if term:
        monkeypatch.setenv("TERM", term)
        monkeypatch.setattr(stream, "isatty", lambda: True)
    line = Status(stream)
    for step in range(35):
        line.show([f"step {step}"], share=step / 35)
    line.print_line("done")
    line.clear()
    rows = stream.getvalue().split("\n")
    assert rows[-2:] == ["done", ""] and "\r" not in stream.getvalue()
    assert [row.split()[-1] for row in rows[:-2]] == ["9", "19", "29"]


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp437", "utf-8"])
def test_any_encoding_and_any_name(encoding: str, clock: list[float]) -> None:
    """Oracle: no error, no character that moves the cursor, no wrapped line."""
    terminal = Terminal(60, encoding)
    reported = Counted(Status(terminal), 3, "view")
    for done in (1, 2, 3):
        reported(done, "Gruß 写真 \x1b[2J\n\t\x07.png")
    text = terminal.said()
    assert "view 3 of 3" in text and "\x1b" not in text and "\n" not in text
    assert all(cells(part) < 60 for part in text.split("\r"))


def test_quiet_writes_nothing() -> None:
    """Oracle: an empty stream."""
    stream = io.StringIO()
    with Status(stream, quiet=True) as line:
        line.print_line("a")
        line.show(["b"], immediate=True)
    assert stream.getvalue() == ""


def test_lines_break_between_words() -> None:
    """Oracle: the words, in lines of a terminal; an unbroken path; unbroken lines in a file."""
    text = "Masks are used: what they hide is not trained. " + "/a/path-that/is-long" * 4
    terminal = Terminal(40)
    rows = wrapped(text, terminal).split("\n")
    assert all(len(row) <= 40 for row in rows[:-1]) and " ".join(rows) == text
    assert wrapped(text, io.StringIO()) == text


def test_cameras_that_were_found_have_a_line(capsys) -> None:
    """Oracle: the figures, once anything follows: `gscore sfm` prints them itself at its end."""
    lines = Lines(sys.stderr)
    figures = {"points": 900, "reprojection_px": 0.514, "seconds": 41.0, "path": "run/capture"}
    lines(SfmDone(photos=60, registered=58, models=2, **figures))
    assert capsys.readouterr().err == ""
    lines(Done(reason="finished", step=1, train_seconds=1.0, splats=1, path="run"))
    said = "Found the cameras of 58 of 60 photos in 41 s; mean reprojection error 0.51 px\n"
    assert capsys.readouterr().err == said


def test_a_whole_training_in_a_terminal(capture, tmp_path) -> None:
    """Oracle: a terminal of 80 x 24: few whole lines, the score once, no moving line left."""
    shown = run_in_terminal(
        gscore(
            "train", str(capture), "-o", "run", "--preset", "preview", "--eval",
            "--iterations", "150", "--checkpoint-seconds", "0.05",
        ),
        cwd=tmp_path,
    )  # fmt: skip
    text = "\n".join(shown.lines)
    assert shown.code == 0 and shown.wrapped == [] and len(shown.lines) <= 18, text
    assert text.count("views: PSNR") == 1 and "[#" not in text and "checkpoints" not in text
    assert "[###" in shown.raw and "growing" not in shown.raw and "polishing" not in shown.raw
    assert "gscore render run -o" in text


@pytest.mark.parametrize("verb", ["train", "eval", "render", "depth", "info"])
def test_something_is_shown_before_anything_slow(verb: str, tmp_path) -> None:
    """Oracle: packages that report when they are loaded, in place of the real ones."""
    for name in ("torch", "numpy"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise ImportError('IT IS LOADED')")
    shown = run_in_terminal(
        gscore(verb, "nothing", "-o", "run"), env={"PYTHONPATH": str(tmp_path)}, cwd=tmp_path
    )
    assert shown.raw.index(f"Starting gscore {verb}") < shown.raw.index("IT IS LOADED")
    assert sys.modules["numpy"].__file__ not in shown.raw


def test_help_does_not_load_torch(tmp_path) -> None:
    """Oracle: a torch that cannot be loaded."""
    (tmp_path / "torch").mkdir()
    (tmp_path / "torch" / "__init__.py").write_text("raise ImportError('IT IS LOADED')")
    for verb in ("train", "sequence", "eval", "depth", "render"):
        shown = run_in_terminal(gscore(verb, "--help"), env={"PYTHONPATH": str(tmp_path)})
        assert shown.code == 0 and "IT IS LOADED" not in shown.raw
        assert "Starting" not in shown.raw and max(map(len, shown.lines)) <= 80
