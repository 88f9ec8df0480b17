"""Requests to a trainer; oracle: the resulting state."""

import os
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path

from gscore.control import Control, end_means_parent_gone, listen


def wait_for(condition: Callable[[], bool], seconds: float = 60.0) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.005)
    return False


def test_lines_lead_to_states() -> None:
    """Oracle: the four commands of the protocol; other lines are kept, empty ones are not."""
    control = Control()
    control.submit("pause\n")
    assert control.paused
    control.submit(" resume ")
    assert not control.paused
    control.submit("snapshot")
    assert control.take_snapshot()
    assert not control.take_snapshot()
    for line in ("Stop!", "", "__init__", "unknown"):
        control.submit(line)
    assert not control.stopping
    assert control.unknown() == ["Stop!", "__init__", "unknown"]
    assert control.unknown() == []
    control.submit("stop")
    assert control.stop_reason == "stopped"
    control.stop("later")
    assert control.stop_reason == "stopped"


def test_a_pause_ends_with_resume_or_stop() -> None:
    """Oracle: the waiting thread, which continues."""
    for way in ("resume", "stop"):
        control = Control()
        control.pause()
        thread = threading.Thread(target=control.wait_while_paused)
        thread.start()
        thread.join(0.1)
        assert thread.is_alive()
        control.submit(way)
        thread.join(60)
        assert not thread.is_alive()


def test_a_pipe_is_read_line_by_line_and_its_end_counts() -> None:
    """Oracle: each command as soon as its line is complete; the end, reported once."""
    control, ends = Control(), []
    read, write = os.pipe()
    thread = listen(control, read, on_end=lambda: ends.append(1))
    os.write(write, b"pau")
    time.sleep(0.05)
    assert not control.paused
    os.write(write, b"se\r\nnonsense\nsnap")
    assert wait_for(lambda: control.paused)
    os.write(write, b"shot\n")
    assert wait_for(control.take_snapshot)
    assert ends == []
    os.close(write)
    thread.join(60)
    assert ends == [1]
    assert control.unknown() == ["nonsense"]
    os.close(read)


def test_only_pipes_and_sockets_end_with_their_parent(tmp_path: Path) -> None:
    """Oracle: the kind of file; /dev/null and files end immediately, which is ignored."""
    (tmp_path / "commands").write_text("pause\n")
    control, ends = Control(), []
    for path in (tmp_path / "commands", Path(os.devnull)):
        descriptor = os.open(path, os.O_RDONLY)
        listen(control, descriptor, on_end=lambda: ends.append(1)).join(60)
        os.close(descriptor)
    assert control.paused
    assert ends == []
    assert not end_means_parent_gone(descriptor)
    a, b = socket.socketpair()
    with a, b:
        if os.name != "nt":
            assert end_means_parent_gone(a.fileno())


def test_commands_can_come_while_the_trainer_looks() -> None:
    """Oracle: no lost request and no deadlock, with a thread that polls continuously."""
    control = Control()

    def ask() -> None:
        for _ in range(2000):
            control.submit("pause")
            control.submit("resume")
        control.submit("snapshot")
        control.stop()

    thread = threading.Thread(target=ask)
    thread.start()
    while not control.stopping:
        control.wait_while_paused()
    thread.join(60)
    assert control.take_snapshot()
    assert not control.paused
