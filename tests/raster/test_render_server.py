"""The render server and its client, with the CPU as the server's device. Oracle, unless stated
otherwise: `gscore.render` in this process, bit by bit."""

import os
import signal
import stat
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gscore.errors import ShapeError
from gscore.raster import render_client, render_process
from gscore.raster.render_client import RenderClient, fingerprint
from tests.raster.render_clients import (
    PATH,
    Drawing,
    drawn,
    needs_posix,
    same,
    splats_of,
    wait_for,
)


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
    code = f"{PATH}.raster.render_server as s; s.KEPT_BYTES = 0; s.main(sys.argv[2:])"
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


def test_output_of_a_driver_does_no_harm(
    client: RenderClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What native code prints to stdout is no message."""
    opened = "s.open_device = lambda *a, o=s.open_device: (os.write(1, b'hello'), o(*a))[1]; "
    code = f"{PATH}.raster.render_server as s; {opened}s.main(sys.argv[2:])"
    monkeypatch.setattr(render_process, "_CODE", code)
    splats = splats_of()
    assert same(drawn(splats, device=client), drawn(splats))
