"""Messages to a render server without a client: bad ones, garbage."""

import contextlib
import json
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from gscore.raster import render_process
from gscore.raster.render_messages import SharedMemory, read_message, write_message
from tests.raster.render_clients import (
    DEADLINE,
)


@pytest.fixture
def raw(tmp_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A server without a client, ready for messages."""
    memory = SharedMemory.created(str(tmp_path))
    memory.reserve(1 << 20)
    command = [sys.executable, "-I", "-c", render_process._CODE, render_process._search_path()]
    with subprocess.Popen(
        [*command, "cpu", "60", memory.name],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        pass_fds=memory.files,
    ) as process:
        assert process.stdout is not None
        assert read_message(process.stdout) == {"ready": "cpu"}
        yield process
        process.kill()


_PART = {"at": 0, "shape": [3], "dtype": "float32"}
_PUT = {"do": "put", "key": "a", "shape": [3], "begin": 0, "part": _PART, "memory": 1 << 20}
BAD = [
    {},
    {"do": "fly"},
    {"do": ["draw"]},
    {"do": "draw"},
    {"do": "draw", "splats": []},
    {"do": "draw", "splats": [3]},
    {**_PUT, "begin": 1},
    {**_PUT, "memory": 1 << 60},
    {**_PUT, "shape": [2]},
    {**_PUT, "shape": [-2]},
    {**_PUT, "shape": [1 << 50]},
    {**_PUT, "part": {**_PART, "at": 1 << 20}},
    {**_PUT, "part": {**_PART, "at": -4}},
    {**_PUT, "part": {**_PART, "shape": [1 << 40]}},
    {**_PUT, "part": {**_PART, "shape": [-1]}},
    {**_PUT, "part": {**_PART, "dtype": "object"}},
]


def test_bad_requests_are_answered(raw: subprocess.Popen[bytes]) -> None:
    """Oracle: an error or a need for each, and a good request afterwards."""
    assert raw.stdin is not None and raw.stdout is not None
    for message in BAD:
        write_message(raw.stdin, message)
        answer = read_message(raw.stdout)
        assert answer is not None and set(answer) <= {"error", "need"} and answer, message
    write_message(raw.stdin, _PUT)
    assert read_message(raw.stdout) == {}


@pytest.mark.parametrize(
    "data",
    [
        struct.pack("<I", 0xFFFF_FFFF) + b"x" * 64,
        struct.pack("<I", 3) + b"{]}",
        struct.pack("<I", 2) + b"[]",
        struct.pack("<I", 4) + b"\xff\xfe\x00\xd8",
        struct.pack("<I", 100_000) + b"[" * 100_000,
    ],
)
def test_garbage_ends_the_server(raw: subprocess.Popen[bytes], data: bytes) -> None:
    """Oracle: exit code 2 and one line."""
    assert raw.stdin is not None and raw.stderr is not None
    with contextlib.suppress(BrokenPipeError):
        raw.stdin.write(data)
        raw.stdin.flush()
    assert raw.wait(DEADLINE) == 2
    lines = raw.stderr.read().decode().splitlines()
    assert len(lines) == 1 and lines[0].startswith("The render server ends: ")


def test_a_truncated_message_is_an_end(raw: subprocess.Popen[bytes]) -> None:
    """Oracle: exit code 0, as at the end of the input."""
    assert raw.stdin is not None
    raw.stdin.write(struct.pack("<I", 50) + json.dumps({"do": "put"}).encode())
    raw.stdin.close()
    assert raw.wait(DEADLINE) == 0
