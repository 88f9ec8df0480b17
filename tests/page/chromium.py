"""A headless Chromium, led by the DevTools protocol over two pipes: JSON ended by zero bytes."""

import base64
import io
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any, Self

import numpy as np
from PIL import Image

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "chrome")
SOFTWARE_GL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
_PATIENCE = 180.0
"""Seconds for an answer: software GL on a busy machine."""


def find_chromium() -> str | None:
    """The program; None: there is none."""
    return next((path for name in PROGRAMS if (path := shutil.which(name))), None)


class Chromium:
    """One browser with one page; use it in a `with`."""

    def __init__(self, program: str, profile: Path, *, gl: bool = True) -> None:
        to_child, self._to = os.pipe()
        self._from, from_child = os.pipe()
        line = [program, "--headless=new", "--no-sandbox", "--remote-debugging-pipe"]
        line += [f"--user-data-dir={profile}", "--hide-scrollbars", "--disable-dev-shm-usage"]
        line += SOFTWARE_GL if gl else ("--disable-gpu", "--disable-webgl", "--disable-3d-apis")
        # Chromium reads from handle 3 and writes to 4; some shells know one-digit ones alone.
        handles = f'exec "$@" 3</dev/fd/{to_child} 4>/dev/fd/{from_child}'
        shell = ["sh", "-c", handles, "sh", *line]
        passed = (to_child, from_child)
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        self._process = subprocess.Popen(shell, pass_fds=passed, **quiet)
        for handle in passed:
            os.close(handle)
        self._number, self._read = 0, b""
        self.events: list[dict[str, Any]] = []
        """What it told without being asked."""
        self._session = ""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        found = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = found["sessionId"]
        for room in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{room}.enable")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._to)
        self._process.terminate()
        self._process.wait(60)
        os.close(self._from)

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """The result of a command."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer["error"]
                return answer["result"]
            self.events.append(answer)

    def _next(self) -> dict[str, Any]:
        end = time.monotonic() + _PATIENCE
        while b"\0" not in self._read:
            ready, _, _ = select.select([self._from], [], [], max(0.0, end - time.monotonic()))
            assert ready, "Chromium does not answer"
            got = os.read(self._from, 1 << 20)
            assert got, "Chromium has ended"
            self._read += got
        message, _, self._read = self._read.partition(b"\0")
        return json.loads(message)

    def size(self, width: int, height: int, *, phone: bool = False) -> None:
        """Set the size of the window, px."""
        metrics = {"width": width, "height": height, "deviceScaleFactor": 2 if phone else 1}
        self.call("Emulation.setDeviceMetricsOverride", mobile=phone, **metrics)
        self.call("Emulation.setTouchEmulationEnabled", enabled=phone)

    def open(self, path: Path, *, until: str = "window.viewer !== undefined") -> None:
        """Load a file and wait until an expression is true."""
        self.call("Page.navigate", url=path.resolve().as_uri())
        end = time.monotonic() + _PATIENCE
        while not self.value(f"document.readyState === 'complete' && ({until})"):
            reported = self.value("document.body && document.body.innerText") or ""
            assert time.monotonic() < end and "cannot be shown" not in reported, reported
            time.sleep(0.1)

    def value(self, expression: str) -> Any:
        """What an expression of JavaScript comes to, promises waited for."""
        options = {"awaitPromise": True, "returnByValue": True}
        found = self.call("Runtime.evaluate", expression=expression, **options)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def screenshot(self) -> np.ndarray:
        """[H, W, 3] uint8 of the window."""
        return _pixels(self.call("Page.captureScreenshot", format="png")["data"])

    def canvas(self) -> np.ndarray:
        """[H, W, 3] uint8: the picture in its right order, in the canvas's own pixels."""
        uri = self.value(
            "viewer.settled().then(() => { viewer.frame(performance.now() + 1e6); "
            "return viewer.canvas.toDataURL('image/png'); })"
        )
        return _pixels(uri.partition(",")[2])

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """`mousePressed`, `mouseMoved`, `mouseReleased` or `mouseWheel`."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def drag(self, start: tuple[int, int], end: tuple[int, int], button: str = "left") -> None:
        """Press, move and let go."""
        held = {"button": button, "clickCount": 1}
        self.mouse("mousePressed", *start, **held)
        self.mouse("mouseMoved", *end, button=button, buttons=1 if button == "left" else 2)
        self.mouse("mouseReleased", *end, **held)

    def touch(self, kind: str, *points: tuple[float, float]) -> None:
        """`touchStart`, `touchMove` or `touchEnd` with these fingers."""
        fingers = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(points)]
        self.call("Input.dispatchTouchEvent", type=kind, touchPoints=fingers)

    def key(self, key: str) -> None:
        """Press and let go."""
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key)

    def complaints(self) -> list[str]:
        """Errors of the page so far, and every request that left it."""
        self.value("0")  # so that what was told before is here
        found = []
        for event in self.events:
            params = event.get("params", {})
            if event["method"] == "Runtime.exceptionThrown":
                found.append(json.dumps(params["exceptionDetails"]))
            if event["method"] == "Log.entryAdded" and params["entry"]["level"] == "error":
                found.append(params["entry"]["text"])
            if event["method"] == "Network.requestWillBeSent":
                url = params["request"]["url"]
                if not url.startswith(("file:", "blob:", "data:", "about:")):
                    found.append(url)
        return found


def _pixels(text: str) -> np.ndarray:
    with Image.open(io.BytesIO(base64.b64decode(text)), formats=("PNG",)) as image:
        return np.asarray(image.convert("RGB"))
