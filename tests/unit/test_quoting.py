"""Input repeated in messages; oracles: lengths by definition, and the syntax trees."""

import ast
import shlex
from pathlib import Path

import pytest

import gscore
from gscore.datasets.pku.cams import read_cam
from gscore.errors import FormatError
from gscore.io.colmap.binary import read_images
from gscore.io.colmap.text import read_cameras
from gscore.quoting import as_typed, brief, first_few, quoted

PACKAGE = Path(gscore.__file__).parent
LARGE = 50_000_000


def test_short_values_are_whole() -> None:
    """Oracle: Python's own repr."""
    for value in ("a.png", 7, 1.5, None, True, [[1.0, 2.0, 3.0, 4.0]] * 4, {"a": [1]}):
        assert quoted(value) == repr(value)
    assert brief(Path("a/b.ply")) == "a/b.ply"


def test_commands_can_be_typed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the split by a shell, and a program that is not on PATH."""
    words = ("render", Path("my photos/run"), "-o", "it's.mp4")
    assert shlex.split(as_typed(*words)) == ["gscore", *map(str, words)]
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr("sys.argv", [".venv/bin/gscore", "train"])
    assert as_typed("info", "a") == ".venv/bin/gscore info a"
    monkeypatch.setattr("sys.argv", ["worker.py"])
    assert as_typed("info", "a") == "gscore info a"


@pytest.mark.parametrize(
    "value", ["x" * LARGE, [0.5] * 1_000_000, {"k": ["x" * LARGE]}, 10**400, b"\0" * LARGE]
)
def test_long_values_are_cut(value: object) -> None:
    """Oracle: 200 letters, the limit of a path in a message."""
    assert len(quoted(value)) <= 200
    assert len(brief(str(value)[:LARGE])) <= 200


def test_unprintable_text_is_replaced() -> None:
    """Oracle: text that UTF-8 can encode."""
    assert brief("a\0b\ud800").encode() == b"a?b?"
    assert len(first_few(["n" * 1000] * 9)) < 1100
    assert first_few(["a", "b", "c"], 2) == "a, b and 1 more" and first_few(["a"]) == "a"


def test_readers_repeat_no_megabytes(tmp_path: Path) -> None:
    """Oracle: the length of the message, for words and names of five megabytes."""
    word = "9x" * 2_500_000
    (tmp_path / "cameras.txt").write_text(f"1 {word} 1 1 1\n")
    with pytest.raises(FormatError, match="unknown camera model '9x") as error:
        list(read_cameras(tmp_path / "cameras.txt"))
    assert len(str(error.value)) < 2000
    (tmp_path / "a.txt").write_text(f"extrinsic {word}\nintrinsic 1")
    with pytest.raises(FormatError, match="in the extrinsic matrix") as error:
        read_cam(tmp_path / "a.txt")
    assert len(str(error.value)) < 2000
    head = (1).to_bytes(8, "little") + bytes(64)
    (tmp_path / "images.bin").write_bytes(head + b"n" * 5_000_000 + bytes(20))
    with pytest.raises(FormatError, match="is longer than 4096 bytes") as error:
        list(read_images(tmp_path / "images.bin"))
    assert len(str(error.value)) < 2000


def _unquoted(path: Path) -> list[str]:
    """Places where an error is raised with a value as Python writes it, of any length."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Raise) or node.exc is None:
            continue
        for part in ast.walk(node.exc):
            if isinstance(part, ast.FormattedValue) and part.conversion == ord("r"):
                if isinstance(part.value, ast.Subscript):  # a slice is short
                    continue
                found.append(f"{path.name} line {part.lineno}")
    return found


@pytest.mark.parametrize("layer", ["io", "datasets", "depth", "trainer", "commands", "bench"])
def test_values_in_errors_go_through_the_helper(layer: str) -> None:
    """Oracle: no `!r` in raised errors."""
    files = [*(PACKAGE / layer).rglob("[!_]*.py"), PACKAGE / "config_file.py"]
    assert not [place for file in files for place in _unquoted(file)]
