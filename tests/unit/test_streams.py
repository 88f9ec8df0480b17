"""Streams that never fail; oracle: streams of Python over pipes and devices."""

import errno
import io
import os
import sys
from pathlib import Path

import pytest

from gscore.commands.terminal.interrupt import Interrupt, SafeStream, safe_streams


def test_closed_pipe_is_reported_once() -> None:
    """Oracle: EPIPE of the system; the descriptor is the null device afterwards."""
    reader, writer = os.pipe()
    os.close(reader)
    reported: list[int | None] = []
    with os.fdopen(writer, "w") as stream:
        steady = SafeStream(stream, lambda error: reported.append(error.errno))
        for _ in range(3):
            print("x" * 100_000, file=steady, flush=True)
        assert reported == [errno.EPIPE]
        assert os.fstat(writer).st_rdev == Path(os.devnull).stat().st_rdev


@pytest.mark.parametrize(
    ("number", "code"), [(errno.EPIPE, 141), (errno.EIO, 129), (errno.ENOSPC, 2)]
)
def test_lost_output_has_an_exit_code(
    number: int, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: the codes of the documentation; a sentence for a full disk."""

    class Broken(io.StringIO):
        def write(self, text: str) -> int:
            raise OSError(number, os.strerror(number))

    monkeypatch.setattr(sys, "stdout", Broken())
    interrupt = Interrupt()
    with safe_streams(interrupt.output_lost):
        sys.stdout.write("hello")
        sys.stdout.write("again")
    assert interrupt.exit_code == code
    assert capsys.readouterr().err.count("the disk is full") == (number == errno.ENOSPC)


def test_a_rank_needs_nobody_who_takes_its_output(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: no request to stop and no exit code, under torchrun's variables alone."""
    asked: list[str] = []

    def lose_output() -> int:
        interrupt = Interrupt()
        with interrupt.stopped_by(asked.append, quiet=True):
            interrupt.output_lost(141)
        return interrupt.exit_code

    assert (lose_output(), asked) == (141, ["output closed"])
    monkeypatch.setenv("RANK", "0")
    monkeypatch.setenv("WORLD_SIZE", "2")
    assert (lose_output(), asked) == (0, ["output closed"])
    monkeypatch.setenv("WORLD_SIZE", "1")
    assert lose_output() == 141


def test_letters_that_a_stream_lacks_are_spelled_out() -> None:
    """Oracle: Python's own escapes."""
    raw = io.BytesIO()
    stream = io.TextIOWrapper(raw, encoding="latin-1")
    steady = SafeStream(stream, lambda error: pytest.fail(str(error)))
    print("é\u2192\ud800", file=steady, flush=True)
    assert raw.getvalue() == b"\xe9\\u2192\\ud800\n"


def test_a_terminal_gets_no_commands() -> None:
    """Oracle: the escapes of Python's literals; a moving line keeps its carriage return."""
    stream = io.StringIO()
    steady = SafeStream(stream, lambda error: pytest.fail(str(error)))
    name = "photo\x1b]0;title\x07\x9b2J\0.png"
    print(f"\r{name}\tis missing", file=steady)
    assert stream.getvalue() == "\rphoto\\x1b]0;title\\x07\\x9b2J\\x00.png\tis missing\n"


def test_the_streams_are_back_afterwards() -> None:
    """Oracle: the original objects."""
    before = sys.stdout, sys.stderr
    with safe_streams(lambda code: None):
        assert isinstance(sys.stdout, SafeStream)
    assert (sys.stdout, sys.stderr) == before
