"""Running a verb of the command line within the tests."""

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


def assert_one_sentence(
    arguments: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The verb ends with code 2 and one line that holds `sentence`."""
    assert main([*arguments, "--quiet"]) == 2
    err = capsys.readouterr().err
    assert sentence in err
    assert err.count("\n") == 1
