"""Trainings with a viewer; oracle: the same training without, and `render` of its result."""

import json
import threading
import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from gscore import DataConfig, read_splats, render
from gscore.config import Strategy
from gscore.control import Control
from gscore.engine.cpu.engine import CpuEngine
from gscore.events import Progress
from gscore.io.cameras_json import read_cameras_json
from gscore.live.server import Server
from gscore.live_options import LiveOptions
from gscore.trainer.run import train
from tests.live.client import Client, frame_request, free_port
from tests.run_verb import gscore  # noqa: F401
from tests.trainer.conftest import capture  # noqa: F401
from tests.trainer.short_run import CONFIG


def camera(folder, index=0):
    """K, with the principal point in the middle, viewmat and size of a camera of a run."""
    cameras = read_cameras_json(folder / "cameras.json")
    K, width, height = cameras.Ks[index].copy(), *map(int, (cameras.widths[0], cameras.heights[0]))
    K[0, 2], K[1, 2] = width / 2, height / 2
    return K, cameras.viewmats[index], width, height


@contextmanager
def looking(port, make_request):
    """A client in its own thread that requests pictures continuously; returns those received."""
    seen, over = [], threading.Event()

    def look():
        while not over.is_set():
            try:
                with Client(port) as client:
                    while not over.is_set():
                        seen.append(client.look(make_request(len(seen))))
            except (OSError, ValueError):
                time.sleep(0.01)

    thread = threading.Thread(target=look)
    thread.start()
    try:
        yield seen
    finally:
        over.set()
        thread.join(60)


@pytest.mark.parametrize("strategy", [Strategy.DEFAULT, Strategy.MCMC])
def test_watching_changes_no_bit(capture, tmp_path, strategy, monkeypatch):  # noqa: F811
    """Oracle: the files of a training without a viewer; sizes of pictures vary meanwhile, and the
    device's submissions are short."""
    config, data, short = replace(CONFIG, strategy=strategy), DataConfig(source=capture), []
    monkeypatch.setattr(CpuEngine, "shorten_submissions", lambda _: short.append(1))
    train(config, data, tmp_path / "alone")
    assert not short
    K, viewmat, width, height = camera(tmp_path / "alone")

    def request(number):
        size = width + 16 * (number % 3), height + 8 * (number % 2)
        return frame_request(viewmat, K, *size, scaling_modifier=1.0 if number % 4 else 0.3)

    port = free_port()
    with Server(LiveOptions(port=port), text="x") as server, looking(port, request) as seen:
        train(config, data, tmp_path / "watched", viewers=server.viewers)
    assert len(short) >= len(seen) >= 5 and all(text == "x" for _, text in seen)
    assert any(np.ptp(picture) > 50 for picture, _ in seen)
    for name in ("point_cloud.ply", "cameras.json"):
        one, other = (tmp_path / folder / name for folder in ("alone", "watched"))
        assert one.read_bytes() == other.read_bytes()


def test_viewer_pauses_the_training(capture, tmp_path):  # noqa: F811
    """Oracle: the same step while it waits; the last picture is that of the PLY."""
    data, out = DataConfig(source=capture), tmp_path / "out"
    events, pictures, port = [], {}, free_port()

    def watch(server_is_up):
        server_is_up.wait()
        with Client(port) as client:
            client.look({"resolution_x": 0, "resolution_y": 0, "train": 0})
            pictures["held"] = [e.step for e in events if isinstance(e, Progress)][-1:]
            time.sleep(0.5)
            K, viewmat, width, height = camera(out)
            ask = frame_request(viewmat, K, width, height, train=0, keep_alive=1)
            first, again = client.look(ask)[0], client.look(ask)[0]
            assert np.array_equal(first, again)
            while not (out / "report.html").is_file():
                client.look(ask | {"train": 1})
            pictures["end"] = client.look(ask | {"train": 1})[0]
            small = client.look(ask | {"train": 1, "scaling_modifier": 0.05})[0]
            pictures["small"] = small
            client.send(ask | {"train": 1, "keep_alive": 0})

    up = threading.Event()
    thread = threading.Thread(target=watch, args=(up,))
    with Server(LiveOptions(port=port), after_the_end=True) as server:
        thread.start()

        def note(event):
            events.append(event)
            up.set()

        result = train(CONFIG, data, out, note, Control(), viewers=server.viewers)
    thread.join(60)
    assert result.reason == "finished" and result.steps == CONFIG.iterations
    assert any(isinstance(e, Progress) and e.phase == "paused" for e in events)
    K, viewmat, width, height = camera(out)
    splats = read_splats(out / "point_cloud.ply")

    def drawn(splats):
        return np.clip(render(splats, K, viewmat, width, height).rgb, 0, 1) * 255

    assert np.abs(pictures["end"] - drawn(splats)).max() < 2
    smaller = replace(splats, scales=splats.scales + np.float32(np.log(0.05)))
    assert np.abs(pictures["small"] - drawn(smaller)).max() < 2
    assert np.abs(pictures["small"].astype(float) - pictures["end"]).mean() > 3


def test_a_held_training_can_be_stopped(capture, tmp_path):  # noqa: F811
    """Oracle: its end with a checkpoint, though a viewer pauses it."""
    port, control = free_port(), Control()
    with Server(LiveOptions(port=port)) as server, Client(port) as client:
        client.send({"resolution_x": 0, "resolution_y": 0, "train": 0})
        while not server.viewers.has_pausing_viewer:
            time.sleep(0.01)
        threading.Timer(0.5, control.stop).start()
        data = DataConfig(source=capture)
        result = train(CONFIG, data, tmp_path / "out", None, control, viewers=server.viewers)
    assert result.reason == "stopped" and result.steps == 0


def test_port_in_use_is_reported_before_the_work(capture, tmp_path, gscore):  # noqa: F811
    """Oracle: one sentence, exit code 2, no folder; no port is opened with --disable-viewer."""
    port, out = free_port(), tmp_path / "out"
    line = ("train", capture, "-o", out, "--iterations", "3", "--port", port, "--quiet", "--json")
    with Server(LiveOptions(port=port)):
        code, _, err = gscore(*line)
        assert code == 2 and f"port {port}" in " ".join(err.split()) and not out.exists()
        code, text, err = gscore(*line, "--disable-viewer")
        assert code == 0 and json.loads(text)["steps"] == 3
    code, _, err = gscore(*line, "--overwrite", "--ip", "localhost.example")
    assert code == 2 and "ip must be" in err
    code, _, err = gscore("train", capture, "-o", tmp_path / "b", "--port", "70000")
    assert code == 2 and "port must be 0 to 65535" in err


def test_public_addresses_warn(capture, tmp_path, gscore):  # noqa: F811
    """Oracle: a warning for all addresses, none for the local computer's."""
    line = ("train", capture, "--iterations", "2", "--port", free_port(), "--events", "jsonl")
    _, text, _ = gscore(*line, "-o", tmp_path / "a", "--ip", "0.0.0.0")
    assert "Any computer that reaches 0.0.0.0" in text
    _, text, _ = gscore(*line, "-o", tmp_path / "b")
    assert "Any computer" not in text and "Viewers can connect to 127.0.0.1, port" in text


def test_the_port_is_no_part_of_a_run(capture, tmp_path, gscore):  # noqa: F811
    """Oracle: a config.json, possibly of another user, that opens no port."""
    out = tmp_path / "out"
    gscore("train", capture, "-o", out, "--iterations", "2", "--port", free_port(), "--quiet")
    assert "port" not in json.loads((out / "config.json").read_text())["train"]
