"""The render server and its client, with the CPU as the server's device. Oracle, unless stated
otherwise: `gscore.render` in this process, bit by bit."""

import contextlib
import json
import os
import signal
import stat
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gscore import CancelFlag, Cancelled, Rendered, Splats, render
from gscore.errors import ShapeError
from gscore.raster import render_client, render_process
from gscore.raster.render_client import RenderClient, RenderServerError, fingerprint
from gscore.raster.render_messages import SharedMemory, read_message, write_message

ROOT = Path(__file__).parents[2]
DEADLINE = 60.0
POSIX = sys.platform != "win32"
_PATH = "import os, sys; sys.path[:0] = sys.argv[1].split(os.pathsep); import gscore"
"""Begin of the code of another server; goes on with a module of gscore."""
WAITING = f"""{_PATH}.raster.render_server as s
import time
answer = s.RenderServer.answer
def answer_after_cancel(self, message, cancel):
    found = answer(self, message, cancel)
    if "stats" not in found or message["view"]["width"] != 77:
        return found
    while not cancel.value.value:
        time.sleep(0.01)
    return answer(self, message, cancel)
s.RenderServer.answer = answer_after_cancel
s.main(sys.argv[2:])
"""
"""Code of a server that draws a picture 77 px wide until that is cancelled."""
SLOW = (77, 50)
needs_posix = pytest.mark.skipif(not POSIX, reason="signals and unnamed files are POSIX's")


def splats_of(count: int = 300) -> Splats:
    """Random splats in front of the camera."""
    rng = np.random.default_rng(count)
    return Splats(
        means=(rng.normal(size=(count, 3)) * (1, 1, 0.3) + (0, 0, 4)).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        scales=rng.uniform(-4, -2, (count, 3)).astype(np.float32),
        opacities=rng.uniform(-2, 3, count).astype(np.float32),
        sh0=rng.normal(size=(count, 1, 3)).astype(np.float32),
        shN=(0.2 * rng.normal(size=(count, 8, 3))).astype(np.float32),
    )


def drawn(splats: Splats, size: tuple[int, int] = (85, 64), **how: Any) -> Rendered:
    """The picture of a camera with a turned axis."""
    width, height = size
    K = np.array([[70, 0, width / 2], [0, 71, height / 2], [0, 0, 1.0]])
    viewmat = np.eye(4)
    viewmat[:2, :2] = [[0.8, -0.6], [0.6, 0.8]]
    return render(splats, K, viewmat, width, height, **how)


def same(one: Rendered, other: Rendered) -> bool:
    """Whether two pictures have the same bits."""
    pairs = [(getattr(one, f.name), getattr(other, f.name)) for f in fields(Rendered)]
    return all(np.array_equal(a, b) and type(a) is type(b) for a, b in pairs)


def wait_for(condition: Callable[[], object]) -> None:
    """Wait until a condition holds, and fail after the deadline."""
    until = time.monotonic() + DEADLINE
    while not condition():
        assert time.monotonic() < until, "waited in vain"
        time.sleep(0.01)


def is_gone(pid: int) -> bool:
    """Whether a process has ended; the system may not have collected it yet."""
    with contextlib.suppress(FileNotFoundError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


class Drawing:
    """A picture drawn in a thread."""

    def __init__(self, client: RenderClient, *args: Any, **how: Any) -> None:
        self.result: Any = None
        self._thread = threading.Thread(target=self._run, args=(client, args, how), daemon=True)
        self._thread.start()

    def _run(self, client: RenderClient, args: Any, how: Any) -> None:
        try:
            self.result = drawn(*args, device=client, **how)
        except Exception as error:
            self.result = error

    def end(self) -> Any:
        """The picture, or the exception."""
        self._thread.join(DEADLINE)
        assert not self._thread.is_alive()
        return self.result


@pytest.fixture
def client(tmp_path: Path) -> Iterator[RenderClient]:
    """A client, whose server ends with the test."""
    made = RenderClient("cpu", folder=str(tmp_path))
    yield made
    made.close()


def test_pictures_have_the_same_bits(client: RenderClient) -> None:
    """Windows, depth limits, parallel rays, degrees and no splats; one server draws them all."""
    far = np.full((64, 85), 4, np.float32)
    far[::3] = np.nan
    splats, background = splats_of(), (0.2, 0.4, 0.6)
    ways: list[dict[str, Any]] = [
        {},
        {"window": (20, 10, 50, 30), "background": background},
        {"window": (0, 0, 1, 1)},
        {"far_depths": far},
        {"far_depths": far, "window": (33, 40, 20, 24), "antialias": True},
        {"orthographic": True, "depths": False, "near": 3.9, "far": 4.3},
        {"sh_degree": 1, "threads": 1},
    ]
    for how in ways:
        assert same(drawn(splats, device=client, **how), drawn(splats, **how)), how
    nothing = splats.subset(np.zeros(300, bool))
    assert same(drawn(nothing, device=client), drawn(nothing))
    large = drawn(splats, (500, 400), device=client)
    assert same(large, drawn(splats, (500, 400)))
    assert client.started == 1


def test_splats_are_sent_once(client: RenderClient, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the number of sent arrays. Equal content is known, in whatever arrays; of changed
    splats the changed arrays are sent, in parts."""
    splats = splats_of()
    drawn(splats, device=client)
    assert client.sent == 6
    drawn(splats, device=client)
    drawn(splats.subset(np.ones(300, bool)), device=client)
    assert client.sent == 6
    monkeypatch.setattr(render_client, "PART", 100)
    other = replace(splats, shN=splats.shN + np.float32(0.1))
    assert same(drawn(other, device=client), drawn(other))
    assert client.sent == 7


def test_fingerprints_are_of_content_and_shape() -> None:
    """Oracle: arrays that differ in one number, in shape, or not at all; a new array at the address
    of a dead one."""
    values = np.arange(12, dtype=np.float32)
    other = values.copy()
    assert fingerprint(values) == fingerprint(other)
    assert fingerprint(values.reshape(3, 4)) != fingerprint(values)
    assert fingerprint(values + 1) != fingerprint(values)
    found = {fingerprint(np.full(1000, i, np.float32)) for i in range(50)}
    assert len(found) == 50


def test_models_make_room(client: RenderClient, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the number of sent arrays, when the server keeps one model."""
    code = f"{_PATH}.raster.render_server as s; s.KEPT_BYTES = 0; s.main(sys.argv[2:])"
    monkeypatch.setattr(render_process, "_CODE", code)
    one, two = splats_of(300), splats_of(200)
    for splats in (one, two, one):
        assert same(drawn(splats, device=client), drawn(splats))
    assert client.sent == 18


def test_two_clients_have_two_servers(client: RenderClient) -> None:
    """Oracle: process ids; both draw."""
    other = RenderClient("cpu")
    splats = splats_of()
    assert same(drawn(splats, device=client), drawn(splats, device=other))
    assert None is not client.pid != other.pid is not None
    other.close()
    assert same(drawn(splats, device=client), drawn(splats))


def test_threads_take_turns(client: RenderClient) -> None:
    """Oracle: each thread's own picture."""
    models = [splats_of(100 + i) for i in range(4)]
    for model, drawing in [(m, Drawing(client, m)) for m in models]:
        assert same(drawing.end(), drawn(model))
    assert client.started == 1


@needs_posix
def test_the_file_is_private_and_has_no_name(client: RenderClient, tmp_path: Path) -> None:
    """Oracle: the state of the open file, and an empty folder."""
    drawn(splats_of(), device=client)
    server = client._server
    assert server is not None
    state = os.fstat(server.memory.files[0])
    assert stat.S_IMODE(state.st_mode) == 0o600
    assert state.st_nlink == 0 and state.st_size >= 1 << 20
    assert not list(tmp_path.iterdir())


@needs_posix
def test_its_memory_is_free_after_the_end(client: RenderClient) -> None:
    """Oracle: the number of the open file, which is closed when the server has ended."""
    drawn(splats_of(), device=client)
    server = client._server
    assert server is not None
    number, pid = server.memory.files[0], server.process.pid
    inode = os.fstat(number).st_ino
    del server
    os.kill(pid, signal.SIGKILL)
    wait_for(lambda: client.pid is None)

    def closed() -> bool:
        try:
            return os.fstat(number).st_ino != inode
        except OSError:
            return True

    wait_for(closed)


@needs_posix
def test_a_server_killed_between_pictures_is_started_again(client: RenderClient) -> None:
    """Oracle: process ids."""
    splats = splats_of()
    drawn(splats, device=client)
    pid = client.pid
    assert pid is not None
    os.kill(pid, signal.SIGKILL)
    wait_for(lambda: client.pid is None)
    assert same(drawn(splats, device=client), drawn(splats))
    assert client.pid not in (None, pid) and client.started == 2


@needs_posix
def test_a_server_killed_in_a_picture_is_an_error(client: RenderClient) -> None:
    """Oracle: the sentence; the next picture has a new server."""
    splats = splats_of()
    drawn(splats, device=client)
    pid = client.pid
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)  # it cannot answer
    drawing = Drawing(client, splats)
    wait_for(client._lock.locked)
    os.kill(pid, signal.SIGKILL)
    error = drawing.end()
    assert isinstance(error, RenderServerError)
    assert str(error) == "The render server ended with signal 9."
    assert same(drawn(splats, device=client), drawn(splats))


@needs_posix
def test_a_picture_has_a_time_limit(client: RenderClient) -> None:
    """Oracle: the sentence, and the server's end."""
    splats = splats_of()
    drawn(splats, device=client)
    pid = client.pid
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)
    client._seconds = 0.2
    with pytest.raises(RenderServerError, match=r"^The render server took longer than 0\.2 s\.$"):
        drawn(splats, device=client)
    wait_for(lambda: is_gone(pid))


def test_an_idle_server_ends(tmp_path: Path) -> None:
    """Oracle: the process; the next picture starts another one without an error."""
    client = RenderClient("cpu", idle=0.5, folder=str(tmp_path))
    splats = splats_of()
    for count in (1, 2):
        assert same(drawn(splats, device=client), drawn(splats))
        pid = client.pid
        wait_for(lambda: client.pid is None)
        assert pid is None or is_gone(pid)
        assert client.started >= count


def test_a_drawing_is_cancelled(client: RenderClient, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: Cancelled; the server stays and draws on."""
    monkeypatch.setattr(render_process, "_CODE", WAITING)
    splats, cancel = splats_of(), CancelFlag()
    drawn(splats, device=client)
    pid = client.pid
    drawing = Drawing(client, splats_of(200), SLOW, cancel=cancel)
    wait_for(lambda: client.sent == 12)
    cancel.set()
    assert isinstance(drawing.end(), Cancelled)
    assert same(drawn(splats, device=client), drawn(splats))
    assert client.pid == pid


@needs_posix
def test_waiting_drawings_are_cancelled(client: RenderClient, monkeypatch: Any) -> None:
    """Oracle: Cancelled, for the drawing in a server that does not react, which is killed, and for
    one that waits for its turn."""
    monkeypatch.setattr(render_client, "_CANCEL_SECONDS", 0.1)
    splats = splats_of()
    drawn(splats, device=client)
    pid = client.pid
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)
    flags = CancelFlag(), CancelFlag()
    first = Drawing(client, splats, cancel=flags[0])
    wait_for(client._lock.locked)
    second = Drawing(client, splats, cancel=flags[1])
    flags[1].set()
    assert isinstance(second.end(), Cancelled)
    assert client.pid == pid
    flags[0].set()
    assert isinstance(first.end(), Cancelled)
    wait_for(lambda: is_gone(pid))


_PARENT = """
import sys, threading
from gscore.raster import render_process
from tests.raster.test_render_server import SLOW, WAITING, RenderClient, drawn, splats_of
render_process._CODE = WAITING
client = RenderClient("cpu", idle=999, folder=sys.argv[1])
drawn(splats_of(), device=client)
if sys.argv[2] == "drawing":
    work = threading.Thread(target=drawn, args=(splats_of(200), SLOW), kwargs={"device": client})
    work.start()
    while client.sent < 12:
        pass
print(client.pid, flush=True)
sys.stdin.read()
"""


@needs_posix
@pytest.mark.parametrize("state", ["idle", "drawing"])
def test_the_server_ends_with_its_killed_parent(tmp_path: Path, state: str) -> None:
    """Oracle: the process, also in the middle of a picture; nothing is left in the folder."""
    parent = subprocess.Popen(
        [sys.executable, "-c", _PARENT, str(tmp_path), state],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    with parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        assert not is_gone(pid)
        parent.kill()
    wait_for(lambda: is_gone(pid))
    assert not list(tmp_path.iterdir())


def test_bad_arguments_are_refused_before_they_are_sent(client: RenderClient) -> None:
    """Oracle: the errors of `gscore.render`; those of values come from the server, which stays."""
    splats = splats_of()
    with pytest.raises(ShapeError) as wanted:
        drawn(splats, (0, 5))
    with pytest.raises(ShapeError, match=f"^{wanted.value}$"):
        drawn(splats, (0, 5), device=client)
    assert client.started == 0
    with pytest.raises(ShapeError) as wanted:
        drawn(splats, near=float("nan"))
    with pytest.raises(ShapeError) as found:
        drawn(splats, near=float("nan"), device=client)
    assert str(found.value) == str(wanted.value)
    assert same(drawn(splats, device=client), drawn(splats))
    assert client.started == 1


def test_a_device_that_is_not_there() -> None:
    """Oracle: the sentence of the server."""
    with pytest.raises(RenderServerError, match="not in this computer"):
        drawn(splats_of(), device=RenderClient("99"))


def test_a_full_disk_is_an_error(client: RenderClient, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the sentence."""

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(SharedMemory, "reserve", full)
    with pytest.raises(RenderServerError, match="No space left on device"):
        drawn(splats_of(), device=client)


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


def test_a_server_that_writes_garbage(
    client: RenderClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: an error that says so."""
    code = (
        "import sys, time; sys.stdout.write('warning: ' * 99); sys.stdout.flush(); time.sleep(99)"
    )
    monkeypatch.setattr(render_process, "_CODE", code)
    with pytest.raises(RenderServerError, match="sent a message of"):
        drawn(splats_of(), device=client)


def test_a_python_that_cannot_start(client: RenderClient, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the system's reason."""
    monkeypatch.setattr(render_process, "python_program", lambda: "/nowhere/python")
    with pytest.raises(RenderServerError, match="No such file"):
        drawn(splats_of(), device=client)


def test_output_of_a_driver_does_no_harm(
    client: RenderClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What native code prints to stdout is no message."""
    opened = "s.open_device = lambda *a, o=s.open_device: (os.write(1, b'hello'), o(*a))[1]; "
    code = f"{_PATH}.raster.render_server as s; {opened}s.main(sys.argv[2:])"
    monkeypatch.setattr(render_process, "_CODE", code)
    splats = splats_of()
    assert same(drawn(splats, device=client), drawn(splats))
