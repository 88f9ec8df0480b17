"""Damaged files of every format; oracle: one of our errors or a good result, soon, in little
memory.

`FUZZ_SECONDS` gives each format that long with new damage each time; without it a few fixed ones.
"""

import contextlib
import hashlib
import os
import tempfile
import time
import warnings
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings

from gscore.errors import GsError
from tests.lines_run import lines_run

from .damage import damaged, damaged_json
from .formats import BY_NAME, FORMATS, Format

SECONDS = float(os.environ.get("FUZZ_SECONDS", "0"))
CASES = Path(__file__).parent / "cases"
FOUND = Path(__file__).parents[2] / "build" / "fuzz" / "found"
MOST_LINES, MOST_BYTES, MOST_PICTURE_BYTES = 50_000, 400e6, 1.6e9
"""Limits of the lines of Python that run (17,000 in the worst format), and of memory growth, for a
file of a few kilobytes. Pictures may have 179 megapixels, Pillow's limit, of one colour; decoding
takes four bytes each and a copy."""


def peak_bytes(*, restart: bool) -> float:
    """Peak memory of this process since the last reset; 0 where unknown."""
    try:
        if restart:
            Path("/proc/self/clear_refs").write_text("5")
        status = Path("/proc/self/status").read_text()
    except OSError:
        return 0.0
    key = "VmRSS:" if restart else "VmHWM:"
    return 1024.0 * int(status.split(key)[1].split()[0])


def check(kind: Format, root: Path, raw: bytes) -> None:
    """Read the folder with `raw` in place of the file."""
    (root / kind.file).write_bytes(raw)
    before = peak_bytes(restart=True)

    def read() -> None:
        with warnings.catch_warnings(), contextlib.suppress(GsError):
            warnings.simplefilter("ignore")
            kind.read(root)

    lines = lines_run(read)
    grew = peak_bytes(restart=False) - before
    assert lines < MOST_LINES, f"{lines} lines of Python ran for {len(raw)} bytes"
    most = MOST_PICTURE_BYTES if kind.name.startswith(("image_", "depth_")) else MOST_BYTES
    assert grew < most, f"{grew / 1e6:.0f} MB for {len(raw)} bytes"


@pytest.mark.parametrize("kind", FORMATS, ids=lambda kind: kind.name)
def test_damaged_files(kind: Format) -> None:
    """Oracle: the module's."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        kind.write(root)
        kind.read(root)
        good = (root / kind.file).read_bytes()
        if kind.structured:
            examples = damaged_json(kind.json_in(good)).map(lambda text: kind.put_json(good, text))
        else:
            examples = damaged(good)

        @settings(
            max_examples=50 if SECONDS else 25,
            deadline=None,
            database=None,
            derandomize=not SECONDS,
            suppress_health_check=list(HealthCheck),
        )
        @given(raw=examples)
        def tried(raw: bytes) -> None:
            nonlocal count
            count += 1
            try:
                check(kind, root, raw)
            except BaseException:
                # The last one kept is the smallest that hypothesis finds.
                FOUND.mkdir(parents=True, exist_ok=True)
                (FOUND / kind.name).write_bytes(raw)
                raise

        count, began = 0, time.monotonic()
        while True:
            tried()
            if time.monotonic() - began >= SECONDS:
                break
        print(f"{kind.name}: {count} files")  # noqa: T201


def _cases() -> list[Path]:
    return sorted(path for name in BY_NAME for path in (CASES / name).glob("*"))


@pytest.mark.parametrize("path", _cases(), ids=lambda p: f"{p.parent.name}/{p.name}")
def test_found_cases_stay_fixed(path: Path, tmp_path: Path) -> None:
    """Oracle: the same, for files that once failed."""
    kind = BY_NAME[path.parent.name]
    kind.write(tmp_path)
    check(kind, tmp_path, path.read_bytes())


def test_cases_are_named_by_their_content() -> None:
    """Oracle: SHA-1, so that no case is there twice."""
    for path in _cases():
        assert path.name == hashlib.sha1(path.read_bytes()).hexdigest()[:12]
