"""The server alone, with pictures of one colour; oracle: the protocol, and the surviving
connections."""

import errno
import json
import random
import socket
import threading
import time
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest

from gscore.errors import BackendError, ConfigError
from gscore.live import server, viewer_clients, viewer_protocol
from gscore.live_options import LiveOptions
from tests.live.client import Client, frame_request, free_port

K = np.array([[50.0, 0, 20], [0, 60, 15], [0, 0, 1]])
POSE = np.array([[0.0, 0, 1, 4], [1, 0, 0, 5], [0, 1, 0, 6], [0, 0, 0, 1]])


class Training:
    """Empty steps, between which viewers are served."""

    def __init__(self, *, pause: float = 0.002) -> None:
        self.port = free_port()
        self.server = server.Server(LiveOptions(port=self.port), text="/über/capture")
        self.seen: list[viewer_protocol.FrameRequest] = []
        self.over = threading.Event()
        self._pause = pause

    def __enter__(self):
        self.server.__enter__()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self.over.set()
        self._thread.join()
        self.server.__exit__()

    def _run(self):
        while not self.over.is_set():
            self.server.viewers.answer(self._draw)
            time.sleep(self._pause)

    def _draw(self, request):
        self.seen.append(request)
        return bytes([7, 8, 9]) * (request.width * request.height)


@pytest.fixture
def training(monkeypatch):
    monkeypatch.setattr(server, "PATIENCE", 0.5)
    with Training() as one:
        yield one


def wait_until(condition):
    """Wait for another thread; the deadline is for broken code alone."""
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def look_until_served(training, request):
    """The answer to a new viewer once there is a place for it, and its connection."""
    end = time.monotonic() + 60
    while True:
        client = Client(training.port)
        try:
            return client.look(request)[0], client
        except OSError:
            client.socket.close()
            assert time.monotonic() < end
            time.sleep(0.01)


def test_a_viewer_gets_what_it_asks_for(training):
    """Oracle: the camera of the client's request."""
    with Client(training.port) as client:
        picture, text = client.look(frame_request(POSE, K, 40, 30, scaling_modifier=0.5))
        assert picture.shape == (30, 40, 3) and (picture == (7, 8, 9)).all()
        assert text == "/über/capture"
        (seen,) = training.seen
        assert seen.viewmat == pytest.approx(POSE) and pytest.approx(K) == seen.K
        assert seen.scaling == 0.5 and seen.trains and not seen.stays
        picture, text = client.look({"resolution_x": 0, "resolution_y": 0})
        assert picture.size == 0 and text == "/über/capture" and len(training.seen) == 1


def test_points_land_where_the_viewer_expects_them():
    """Oracle: the product of both matrices, which viewers send too, used as in the 3DGS trainer:
    points as rows, the second coordinate flipped, then from -1 to 1 over the picture."""
    fov_x, fov_y, near, far = 2 * np.arctan(0.4), 2 * np.arctan(0.25), 0.01, 100.0
    clip = np.zeros((4, 4))
    clip[0, 0], clip[1, 1] = 1 / np.tan(fov_x / 2), 1 / np.tan(fov_y / 2)
    clip[2, 2], clip[2, 3] = -(far + near) / (far - near), -2 * far * near / (far - near)
    clip[3, 2] = -1
    opengl = np.diag([1.0, -1, -1, 1]) @ POSE
    sent = {"resolution_x": 40, "resolution_y": 30, "fov_x": fov_x, "fov_y": fov_y}
    sent["view_matrix"] = opengl.astype(np.float32).T.ravel().tolist()
    sent["view_projection_matrix"] = (clip @ opengl).astype(np.float32).T.ravel().tolist()
    sent |= {"train": 1, "keep_alive": 1, "shs_python": 0, "rot_scale_python": 0}
    sent |= {"scaling_modifier": 0.001, "z_near": near, "z_far": far}
    found = viewer_protocol.parse(json.dumps(sent).encode())
    in_camera = np.array([[0.3, -0.2, 2, 1], [-1, 0.5, 4, 1], [0, 0, 1, 1]])
    points = in_camera @ np.linalg.inv(POSE).T

    rows = np.reshape(sent["view_projection_matrix"], (4, 4))
    rows[:, 1] *= -1
    on_screen = points @ rows
    pixels = (on_screen[:, :2] / on_screen[:, 3:] + 1) * (20, 15)
    seen = points @ found.viewmat.T @ np.eye(4)[:, :3] @ found.K.T
    assert seen[:, :2] / seen[:, 2:] == pytest.approx(pixels, abs=1e-4)
    assert found.stays and found.scaling == 0.001


@pytest.mark.parametrize("error", [MemoryError, BackendError])
def test_a_picture_that_cannot_be_drawn_is_black(training, monkeypatch, caplog, error):
    """Oracle: black pixels and a warning; later pictures are drawn as before."""

    def fail(_):
        raise error("too little memory")

    with Client(training.port) as client:
        with monkeypatch.context() as patch:
            patch.setattr(training, "_draw", fail)
            assert not client.look(frame_request(POSE, K, 4, 3))[0].any()
        assert "too little memory" in caplog.text
        assert client.look(frame_request(POSE, K, 4, 3))[0].all()


def test_several_viewers_at_once_and_after_each_other(training):
    """Oracle: pictures of each viewer's own size, repeatedly."""
    with Client(training.port) as one, Client(training.port) as two:
        for _ in range(5):
            a, b = frame_request(POSE, K, 8, 6), frame_request(POSE, K, 10, 4)
            one.send(a)
            two.send(b)
            assert two.receive(b)[0].shape == (4, 10, 3)
            assert one.receive(a)[0].shape == (6, 8, 3)
    for _ in range(2 * server.MOST_VIEWERS):
        with Client(training.port) as client:
            assert client.look(frame_request(POSE, K, 8, 6))[0].shape == (6, 8, 3)
            time.sleep(0.01)


def test_one_more_than_there_may_be_is_let_go(training):
    """Oracle: the number; a freed place is given again."""
    clients = [Client(training.port) for _ in range(server.MOST_VIEWERS)]
    for client in clients:
        client.look(frame_request(POSE, K, 4, 4))
    with Client(training.port) as late:
        assert late.is_dropped()
    clients.pop().socket.close()
    picture, client = look_until_served(training, frame_request(POSE, K, 4, 4))
    assert picture.shape == (4, 4, 3)
    for one in (client, *clients):
        one.socket.close()


GOOD = frame_request(POSE, K, 40, 30)
SKEWED = [2 * value for value in GOOD["view_matrix"]]


@pytest.mark.parametrize(
    "changes",
    [
        {"resolution_x": -5},
        {"resolution_x": 10**9},
        {"resolution_x": 8000, "resolution_y": 8000},
        {"resolution_x": 40.5},
        {"resolution_x": "40"},
        {"resolution_x": True},
        {"fov_x": 0.0},
        {"fov_x": 3.2},
        {"fov_y": float("nan")},
        {"fov_y": None},
        {"scaling_modifier": 1e9},
        {"scaling_modifier": float("inf")},
        {"view_matrix": GOOD["view_matrix"][:15]},
        {"view_matrix": ["1"] * 16},
        {"view_matrix": [float("nan")] * 16},
        {"view_matrix": [1e300] * 16},
        {"view_matrix": SKEWED},
        {"view_matrix": [0.0] * 16},
        {"view_matrix": {}},
        {"train": "yes"},
    ],
)
def test_degenerate_cameras_are_refused(changes):
    """Oracle: ValueError, and no other error; the request without the change is valid."""
    assert viewer_protocol.parse(json.dumps(GOOD).encode()).width == 40
    with pytest.raises(ValueError, match=r"\S"):
        viewer_protocol.parse(json.dumps(GOOD | changes).encode())


@pytest.mark.parametrize(
    "raw",
    [
        b"GET / HTTP/1.1\r\n\r\n",
        b"\x00\x00\x00\x00",
        b"\xff\xff\xff\xff",
        b"\x05\x00\x00\x00{}{}{",
        b"\x02\x00\x00\x00[]",
        b"\x04\x00\x00\x00\xff\xfe\xfd\xfc",
        (20_000).to_bytes(4, "little") + b"[" * 20_000,
        (40).to_bytes(4, "little") + b'{"resolution_x": 99999999999999999999999}',
    ],
)
def test_garbage_is_let_go(training, raw):
    """Oracle: a closed connection; another viewer is served as before."""
    with Client(training.port) as bad, Client(training.port) as good:
        bad.socket.sendall(raw)
        assert bad.is_dropped()
        assert good.look(frame_request(POSE, K, 4, 4))[0].shape == (4, 4, 3)


def test_random_bytes_end_no_thread(training):
    """Oracle: 300 random messages, half of them valid ones with changed bytes; then a valid one."""
    chance = random.Random(5)
    text = json.dumps(GOOD).encode()
    for _ in range(300):
        raw = bytearray(text)
        for _ in range(chance.randrange(1, 8)):
            raw[chance.randrange(len(raw))] = chance.randrange(256)
        try:
            viewer_protocol.parse(bytes(raw if chance.random() < 0.5 else chance.randbytes(50)))
        except ValueError:
            continue
    with Client(training.port) as client:
        assert client.look(frame_request(POSE, K, 4, 4))[0].shape == (4, 4, 3)


@pytest.mark.parametrize("slowly", [False, True])
def test_half_a_message_is_waited_for_only_so_long(training, slowly):
    """Oracle: the timeout, for all of a message: a sender of small pieces is dropped before its
    message is complete."""
    text = json.dumps(GOOD).encode()
    raw = len(text).to_bytes(4, "little") + text
    with Client(training.port) as half, Client(training.port) as good:
        half.socket.sendall(raw[:3])
        with pytest.raises(ConnectionError) if slowly else nullcontext():
            for at in range(3, len(raw) - 1) if slowly else ():
                time.sleep(0.05)
                half.socket.sendall(raw[at : at + 1])
        assert good.look(frame_request(POSE, K, 4, 4))[0].shape == (4, 4, 3)
        assert half.is_dropped()


def test_a_slow_reader_holds_nobody_up(training):
    """Oracle: a client that requests large pictures and reads none; others are served, and it is
    dropped."""
    large = frame_request(POSE, K, 3000, 2500)
    with Client(training.port) as slow, Client(training.port) as good:
        slow.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.send(large)
        for _ in range(5):
            assert good.look(frame_request(POSE, K, 4, 4))[0].shape == (4, 4, 3)
        wait_until(lambda: len(training.seen) == 6 and len(training.server._connections) == 1)
        # The data that the system still buffered for it are dropped: through so small a window they
        # take minutes.
        with pytest.raises(ConnectionError):
            slow.receive(large)


def test_silent_viewers_give_their_places(training, monkeypatch):
    """Oracle: full places, all of connections that send no request but one; a new client is refused
    before the timeout, and gets the place of a silent one after it."""
    monkeypatch.setattr(server, "PATIENCE", 60.0)
    busy = Client(training.port)
    silent = [Client(training.port) for _ in range(server.MOST_VIEWERS - 1)]
    busy.look(frame_request(POSE, K, 4, 4))
    wait_until(lambda: len(training.server._connections) == server.MOST_VIEWERS)
    with Client(training.port) as late:
        assert late.is_dropped()
    for one in training.server.viewers._all:
        one.last_request -= 100.0
    busy.look(frame_request(POSE, K, 4, 4))
    with Client(training.port) as late:
        assert late.look(frame_request(POSE, K, 8, 4))[0].shape == (4, 8, 3)
        assert silent[0].is_dropped()
        assert busy.look(frame_request(POSE, K, 4, 4))[0].shape == (4, 4, 3)
    for client in (busy, *silent):
        client.socket.close()


def test_viewers_are_asked_whether_they_are_there(training):
    """Oracle: the keep-alive option of the connection, without which a broken one stays for
    ever."""
    with Client(training.port) as client:
        client.look(frame_request(POSE, K, 4, 4))
        (connection,) = training.server._connections
        assert connection.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)


def test_lost_viewer_does_not_delay_the_end(monkeypatch):
    """Oracle: the time for which a request counts, for a viewer that had another pending."""
    monkeypatch.setattr(viewer_clients, "HOLD", 0.0)
    crowd = viewer_clients.ViewerClients(after_the_end=True)
    one = crowd.enter(1)
    assert one is not None
    request = viewer_protocol.parse(json.dumps(frame_request(POSE, K, 4, 4, keep_alive=1)).encode())
    thread = threading.Thread(target=one.request_picture, args=(request,))
    thread.start()
    wait_until(crowd._requested.is_set)
    assert crowd.stay and crowd.longest_idle(0.0) is None  # waits for its answer
    crowd.answer(lambda request: bytes(48))
    thread.join()
    assert not crowd.stay and crowd.longest_idle(0.0) is one
    crowd.close()


@pytest.mark.parametrize("broken", ["accept", "thread"])
def test_a_lasting_fault_is_waited_out(training, monkeypatch, caplog, broken):
    """Oracle: a rest after each try while files or threads have run out, one warning, and a viewer
    that is served afterwards."""
    tries, rests, real = [], [], time.sleep
    monkeypatch.setattr(
        server.time, "sleep", lambda s: (real(s), rests.append(s) if s == server._REST else None)
    )

    def fail(*_, **__):
        tries.append(1)
        raise OSError(24, "Too many open files") if broken == "accept" else RuntimeError("threads")

    class Broken:
        accept = fail

        def __getattr__(self, name):
            return getattr(listening, name)

    listening = training.server._socket
    with monkeypatch.context() as patch:
        if broken == "accept":
            patch.setattr(training.server, "_socket", Broken())
        else:
            patch.setattr(threading.Thread, "start", fail)
        clients = [Client(training.port) for _ in range(3)]
        wait_until(lambda: rests)
        for client in clients:
            client.socket.close()
    assert len(tries) <= len(rests) + 1
    assert caplog.text.count("A viewer cannot connect") == 1
    with Client(training.port) as client:
        assert client.look(frame_request(POSE, K, 4, 4))[0].shape == (4, 4, 3)
    wait_until(lambda: not (training.server.viewers._all or training.server._connections))


def reset(connection: socket.socket) -> None:
    """Close with RST instead of FIN."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, server._NO_LINGERING)
    connection.close()


def test_a_viewer_is_answered_after_a_flood_of_resets():
    """Oracle: TCP's own state: connections established before any accept, which needs a place in
    the queue for each. All are reset, then a viewer gets its picture."""
    training, count = Training(), min(300, socket.SOMAXCONN)  # macOS: 128
    flood = [
        socket.create_connection(("127.0.0.1", training.port), timeout=0.5) for _ in range(count)
    ]
    for connection in flood:
        reset(connection)
    with training, Client(training.port) as client:
        assert client.look(frame_request(POSE, K, 4, 4))[0].shape == (4, 4, 3)


@pytest.mark.parametrize("where", ["accept", "option"])
def test_a_fault_of_one_connection_delays_no_other(training, monkeypatch, caplog, where):
    """Oracle: the waits of the accepting thread, none for faults that systems report of a reset
    connection: ECONNABORTED of Linux, EINVAL of macOS."""
    waits, faults, real = [], [], time.sleep

    def fail(*_):
        faults.append(1)
        raise (
            ConnectionAbortedError(errno.ECONNABORTED, "aborted")
            if where == "accept"
            else (OSError(errno.EINVAL, "Invalid argument"))
        )

    class Aborting:
        def accept(self):
            connection, address = listening.accept()
            if len(faults) < 20:
                connection.close()
                fail()
            return connection, address

        def __getattr__(self, name):
            return getattr(listening, name)

    listening = training.server._socket
    monkeypatch.setattr(server.time, "sleep", lambda s: (waits.append(s), real(s)))
    with monkeypatch.context() as patch:
        if where == "accept":
            patch.setattr(training.server, "_socket", Aborting())
        else:
            patch.setattr(server, "_keep_alive", fail)
        end = time.monotonic() + 60
        while len(faults) < 20 and time.monotonic() < end:
            Client(training.port).socket.close()
    with Client(training.port) as client:
        assert client.look(frame_request(POSE, K, 4, 4))[0].shape == (4, 4, 3)
    assert len(faults) >= 20 and server._REST not in waits
    assert "cannot connect" not in caplog.text


def test_viewers_that_vanish_leave_no_threads(training):
    """Oracle: the threads of this process; one of an earlier test may end meanwhile."""
    before = set(threading.enumerate())
    for at in (0, 2, 10, 10_000):
        with Client(training.port) as client:
            text = json.dumps(GOOD).encode()
            client.socket.sendall((len(text).to_bytes(4, "little") + text)[:at])
    wait_until(lambda: not set(threading.enumerate()) - before)
    assert not training.server.viewers.has_pausing_viewer


def test_a_viewer_that_falls_silent_holds_nothing(training, monkeypatch):
    """Oracle: the time for which a request counts; a training viewer pauses nothing."""
    with Client(training.port) as client:
        client.look({"resolution_x": 0, "resolution_y": 0, "train": 0})
        assert training.server.viewers.has_pausing_viewer
        client.look({"resolution_x": 0, "resolution_y": 0, "train": 1})
        assert not training.server.viewers.has_pausing_viewer
        client.look({"resolution_x": 0, "resolution_y": 0, "train": 0})
        monkeypatch.setattr(viewer_clients, "HOLD", 0.0)
        wait_until(lambda: not training.server.viewers.has_pausing_viewer)


def test_request_after_close_returns_none():
    """Oracle: None, immediately."""
    crowd = viewer_clients.ViewerClients()
    one = crowd.enter(1)
    assert one is not None and crowd.enter(1) is None
    crowd.close()
    assert one.request_picture(viewer_protocol.parse(json.dumps(GOOD).encode())) is None
    assert crowd.enter(5) is None


def test_drawing_takes_half_of_the_time_at_most(monkeypatch):
    """Oracle: a clock that a picture moves by 50 ms and a step by 2 ms, and a viewer with a request
    before each step: 25 steps of 2 ms after each picture."""
    clock, pictures, steps = [100.0], [], []
    monkeypatch.setattr(viewer_clients, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    crowd = viewer_clients.ViewerClients()
    one = crowd.enter(1)
    request = viewer_protocol.parse(json.dumps(GOOD).encode())

    def draw(_: viewer_protocol.FrameRequest) -> bytes:
        clock[0] += 0.05
        pictures.append(len(steps))
        return bytes(48)

    for _ in range(100):
        one.request = request  # what `request_picture` does in the viewer's thread
        crowd.wake()
        crowd.answer(draw)
        steps.append(clock[0])
        clock[0] += 0.002
    assert set(np.diff(pictures)) <= {25, 26} and len(pictures) == 4  # 26: by rounding


def test_ports_in_use_are_reported():
    """Oracle: a second server at the port of the first; a later one may use it again."""
    port = free_port()
    with server.Server(LiveOptions(port=port)), pytest.raises(ConfigError, match=r"choose another"):
        server.Server(LiveOptions(port=port))
    with server.Server(LiveOptions(port=port)):
        pass


@pytest.mark.parametrize("ip", ["example.org", "", "1.2.3", "203.0.113.7", "\ud800"])
def test_invalid_addresses_are_reported(ip):
    """Oracle: one sentence; no name is resolved. The fourth is unassigned (RFC 5737)."""
    with pytest.raises(ConfigError, match=r"ip must be|cannot connect to"):
        server.Server(LiveOptions(port=free_port(), ip=ip))


def test_it_listens_at_one_address_alone():
    """Oracle: the socket's own name."""
    one = server.Server(LiveOptions(port=free_port()))
    with one:
        assert one._socket.getsockname()[0] == "127.0.0.1"
