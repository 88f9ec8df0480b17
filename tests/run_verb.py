"""Running a verb of the command line within the tests."""

from collections.abc import Callable
from pathlib import Path

import pytest

from gscore.commands import main


def hide_networks(patch: pytest.MonkeyPatch) -> None:
    """So that a run and its `eval` measure the same on any machine: without LPIPS."""
    patch.delenv("GSCORE_LPIPS", raising=False)
    patch.delenv("GSCORE_DATA", raising=False)


@pytest.fixture
def gscore(capsys, monkeypatch):
    """Run a verb; gives the exit code, what it printed, and what it printed on stderr."""
    hide_networks(monkeypatch)

    def call(*arguments):
        code = main([str(a) for a in arguments])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


@pytest.fixture
def refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., None]:
    """Run a verb with words in which `{out}` and other places stand; it must end with code 2, one
    sentence and no output folder."""

    def call(verb: str, arguments: list[str], sentence: str, **places: Path) -> None:
        out = tmp_path / "out"
        filled = [argument.format(out=out, **places) for argument in arguments]
        assert main([verb, *filled, "--quiet"]) == 2
        err = capsys.readouterr().err
        assert sentence in err
        assert err.count("\n") == 1
        assert not out.exists()

    return call
