"""A viewer as described in docs/view.md, written from that page, for tests alone."""

import json
import math
import socket
from typing import Any, Self

import numpy as np


def free_port() -> int:
    """A port without a listener."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def frame_request(viewmat: np.ndarray, K: np.ndarray, width: int, height: int, **more: Any) -> dict:
    """The frame request for a camera with OpenCV axes and a centred principal point."""
    opengl = np.diag([1.0, -1, -1, 1]) @ viewmat
    clip = np.eye(4)  # any server may ignore it
    fov = {
        "fov_x": 2 * math.atan(width / 2 / K[0, 0]),
        "fov_y": 2 * math.atan(height / 2 / K[1, 1]),
    }
    return {
        "train": 1,
        "shs_python": 0,
        "rot_scale_python": 0,
        "keep_alive": 0,
        "scaling_modifier": 1.0,
        "resolution_x": width,
        "resolution_y": height,
        **fov,
        "z_near": 0.01,
        "z_far": 100.0,
        # In column-major order.
        "view_matrix": opengl.T.ravel().tolist(),
        "view_projection_matrix": clip.T.ravel().tolist(),
    } | more


class Client:
    """One connection."""

    def __init__(self, port: int, *, patience: float = 60.0) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=patience)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def send(self, request: dict) -> None:
        """A request: its length, then its text."""
        text = json.dumps(request).encode()
        self.socket.sendall(len(text).to_bytes(4, "little") + text)

    def look(self, request: dict) -> tuple[np.ndarray, str]:
        """The picture, [H, W, 3] uint8, and the text after it."""
        self.send(request)
        return self.receive(request)

    def receive(self, request: dict) -> tuple[np.ndarray, str]:
        """The answer to a request that was sent."""
        width, height = request["resolution_x"], request["resolution_y"]
        pixels = np.frombuffer(self._exactly(width * height * 3), np.uint8)
        text = self._exactly(int.from_bytes(self._exactly(4), "little")).decode()
        return pixels.reshape(height, width, 3), text

    def is_dropped(self) -> bool:
        """Whether the server has closed the connection; waits for it."""
        try:
            return self.socket.recv(1) == b""
        except ConnectionError:
            return True

    def _exactly(self, count: int) -> bytes:
        found = bytearray()
        while len(found) < count:
            piece = self.socket.recv(count - len(found))
            if not piece:
                raise ConnectionError("the server is gone")
            found += piece
        return bytes(found)
