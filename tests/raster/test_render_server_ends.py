"""Ends of the render server: killed, late, idle, cancelled, without its parent, without a disk.
Oracle, unless stated otherwise: `gscore.render` in this process, bit by bit."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from gscore import CancelFlag, Cancelled
from gscore.raster import render_client, render_process
from gscore.raster.render_client import RenderClient, RenderServerError, find_devices
from gscore.raster.render_messages import SharedMemory
from tests.raster.render_clients import (
    ROOT,
    SLOW,
    WAITING,
    Drawing,
    drawn,
    is_gone,
    needs_posix,
    same,
    splats_of,
    wait_for,
)


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
from gscore.raster.render_client import RenderClient
from gscore.raster.render_messages import SharedMemory
from tests.raster.render_clients import SLOW, WAITING, drawn, splats_of
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


def test_a_device_that_is_not_there() -> None:
    """Oracle: the sentence of the server."""
    with pytest.raises(RenderServerError, match="not in this computer"):
        drawn(splats_of(), device=RenderClient("f" * 32))


def test_a_full_disk_is_an_error(client: RenderClient, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the sentence."""

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(SharedMemory, "reserve", full)
    with pytest.raises(RenderServerError, match="No space left on device"):
        drawn(splats_of(), device=client)


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
    with pytest.raises(RenderServerError, match="No such file"):
        find_devices()
