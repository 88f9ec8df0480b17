"""Depth networks by name, from a local hub of files that speaks the hub's protocol."""

import hashlib
import json
import logging
import logging.handlers
import threading
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper

from gscore.commands import main
from gscore.depth import catalogue, hub
from gscore.depth.catalogue import NETWORKS, known
from gscore.depth.hub import cached_file, network_file
from gscore.errors import BackendError, FormatError, GsError

from .conftest import Planes

Out = pytest.CaptureFixture[str]
huggingface_hub = pytest.importorskip("huggingface_hub")


def _graph(patch: int, size: int | str, *, attention: bool) -> bytes:
    """A tiny network with a family's input and output: the brightness, as inverse depth.

    Args:
        patch: Kernel and stride of the first convolution, 14 as DINOv2; 1: none.
        size: Sides of its input.
        attention: Adds a Softmax, as in transformers.
    """
    weights = np.full((1, 3, 1, 1), 1 / 3, np.float32)
    made = [numpy_helper.from_array(weights, "w")]
    nodes = [helper.make_node("Conv", ["x", "w"], ["grey"], kernel_shape=[1, 1])]
    last = "grey"
    if attention:
        # The weight 0 keeps the branch in the graph without an effect on the map.
        kernel = np.zeros((1, 3, patch, patch), np.float32)
        made.append(numpy_helper.from_array(kernel, "patches"))
        nodes = [
            helper.make_node(
                "Conv", ["x", "patches"], ["p"], kernel_shape=[patch] * 2, strides=[patch] * 2
            ),
            helper.make_node("Softmax", ["p"], ["soft"], axis=3),
            helper.make_node("ReduceMean", ["soft"], ["mean"], keepdims=1),
            *nodes,
            helper.make_node("Mul", ["grey", "mean"], ["scaled"]),
        ]
        last = "scaled"
    nodes.append(helper.make_node("Identity", [last], ["predicted_depth"]))
    graph = helper.make_graph(
        nodes,
        "tiny",
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 3, size, size])],
        [helper.make_tensor_value_info("predicted_depth", TensorProto.FLOAT, None)],
        made,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)])
    model.ir_version = 8
    return model.SerializeToString()


_FILES = {
    "depth-anything-v2-small": _graph(14, "side", attention=True),
    "depth-anything-v2-base": _graph(14, "side", attention=True),
    "midas-v2.1-small": _graph(1, 256, attention=False),
    "dpt-hybrid-midas": _graph(16, 384, attention=True),
}


class _Hub:
    """Files by the addresses of the hub, and the requests."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.asked: list[str] = []
        owner = self

        class Handler(BaseHTTPRequestHandler):
            def _answer(self, *, body: bool) -> None:
                path = self.path.partition("?")[0]
                owner.asked.append(f"{self.command} {path}")
                data = owner.files.get(path)
                self.send_response(404 if data is None else 200)
                if data is None:
                    self.send_header("X-Error-Code", "EntryNotFound")
                    data = b""
                else:
                    digest = hashlib.sha256(data).hexdigest()
                    self.send_header("X-Repo-Commit", path.split("/")[4])
                    self.send_header("X-Linked-Etag", f'"{digest}"')
                    self.send_header("X-Linked-Size", str(len(data)))
                    self.send_header("ETag", f'"{digest}"')
                self.send_header("Content-Length", str(len(data)))
                self.end_headers()
                if body:
                    self.wfile.write(data)

            def do_HEAD(self) -> None:
                self._answer(body=False)

            def do_GET(self) -> None:
                self._answer(body=True)

            def log_message(self, *_: Any) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.address = f"http://127.0.0.1:{self._server.server_port}"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()


def _use(monkeypatch: pytest.MonkeyPatch, address: str, cache: Path) -> None:
    """Set the endpoint as HF_ENDPOINT and HF_HOME do, which the library reads on import."""
    from huggingface_hub import constants, file_download

    monkeypatch.setattr(constants, "ENDPOINT", address)
    monkeypatch.setattr(
        constants,
        "HUGGINGFACE_CO_URL_TEMPLATE",
        address + "/{repo_id}/resolve/{revision}/{filename}",
    )
    for module in (constants, file_download):
        if hasattr(module, "HF_HUB_CACHE"):
            monkeypatch.setattr(module, "HF_HUB_CACHE", str(cache))


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[_Hub]:
    """The hub with the tiny files, and the table with their SHA-256."""
    server = _Hub()
    entries = []
    for entry in NETWORKS:
        data = _FILES[entry.name]
        server.files[f"/{entry.repository}/resolve/{entry.revision}/{entry.file}"] = data
        entries.append(replace(entry, sha256=hashlib.sha256(data).hexdigest(), bytes=len(data)))
    monkeypatch.setattr(catalogue, "NETWORKS", tuple(entries))
    _use(monkeypatch, server.address, tmp_path / "cache")
    yield server
    server.close()


@pytest.mark.parametrize("name", list(_FILES))
def test_a_name_predicts_after_one_download(
    served: _Hub, tmp_path: Path, capsys: Out, name: str
) -> None:
    """Oracle: the planes' own inverse depth, which the photos show as brightness; the requests."""
    capture = tmp_path / "capture"
    Planes(capture, views=4, width=200, height=140)
    line = ["depth", str(capture), "--model", name, "--quiet", "--json"]
    assert main(line) == 2
    said = " ".join(capsys.readouterr().err.split())
    entry = known(name)
    assert entry is not None and entry.licence in said and "--download" in said
    assert served.asked == []
    assert main([*line, "--download"]) == 0
    facts = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert facts["predicted"] == 4 and facts["accepted"] == 4 and facts["kind"] == "inverse"
    asked = len(served.asked)
    assert asked >= 2
    assert main([*line, "--overwrite"]) == 0  # from the cache, without a request to the hub
    assert len(served.asked) == asked


def test_another_file_is_removed(served: _Hub) -> None:
    """Oracle: the sentence; no part of it stays in the cache, and a second try requests it
    again."""
    entry = known("midas-v2.1-small")
    assert entry is not None
    (path,) = [path for path in served.files if "midas_v21" in path]
    right, served.files[path] = served.files[path], b"something else"
    with pytest.raises(FormatError, match="has the SHA-256"):
        network_file(entry, download=True)
    assert cached_file(entry) is None
    served.files[path] = right
    assert network_file(entry, download=True).read_bytes() == right


def test_missing_hub_file_is_reported(served: _Hub) -> None:
    """Oracle: the sentence for the hub's answer 404."""
    entry = known("midas-v2.1-small")
    assert entry is not None
    served.files.clear()
    with pytest.raises(GsError, match=r"has no midas_v21_small_256\.onnx"):
        network_file(entry, download=True)


def test_unreachable_hub_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: one sentence with the cause where no server listens, without the library's log, which
    repeats itself with each try."""
    _use(monkeypatch, "http://127.0.0.1:9", tmp_path)
    log, said = logging.getLogger("huggingface_hub"), logging.handlers.BufferingHandler(1000)
    log.addHandler(said)
    try:
        with pytest.raises(GsError, match=r"cannot be reached \(.*refused"):
            network_file(NETWORKS[0], download=True)
    finally:
        log.removeHandler(said)
    assert said.buffer == []


def test_without_the_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the command that installs it."""
    import sys

    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(BackendError, match=r"gscore\[hub\]"):
        network_file(NETWORKS[0], download=False)


def test_the_list_tells_what_is_here(served: _Hub, capsys: Out) -> None:
    """Oracle: the table; a file that was downloaded."""
    entry = known("dpt-hybrid-midas")
    assert entry is not None
    there = network_file(entry, download=True)
    assert main(["depth", "--list-models", "--json"]) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["models"]}
    assert rows[entry.name]["file"] == str(there)
    assert [row["file"] for name, row in rows.items() if name != entry.name] == [None] * 3
    assert main(["depth", "--list-models"]) == 0
    said = capsys.readouterr().out
    assert all(network.name in said and network.licence in said for network in NETWORKS)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--model", "depth-anything"], "one of depth-anything-v2-small"),
        (["--model", "x.onnx", "--download"], "needs a --model with a name"),
        (["--download"], "needs a --model with a name"),
    ],
)
def test_names_that_are_none_are_refused(
    words: list[str], says: str, tmp_path: Path, capsys: Out
) -> None:
    """Oracle: exit code 2 and the valid names."""
    Planes(tmp_path, views=3)
    assert main(["depth", str(tmp_path), *words]) == 2
    assert says in " ".join(capsys.readouterr().err.split())


def test_the_table_is_whole() -> None:
    """Oracle: the forms of commits and digests; different names."""
    assert len({network.name for network in NETWORKS}) == len(NETWORKS)
    for network in NETWORKS:
        assert len(network.revision) == 40 and len(network.sha256) == 64
        int(network.revision, 16), int(network.sha256, 16)
        assert network.bytes > 10_000_000
    assert hub.terms(NETWORKS[0]).startswith("99.1 MB, licence Apache-2.0, from https://")
