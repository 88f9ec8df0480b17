"""Processes that a torchrun has started, found so that tests can signal them."""

import time
from collections.abc import Collection
from pathlib import Path

from .start_ranks import PATIENCE


def wait_for(path: Path) -> None:
    """Wait until a file is there."""
    end = time.monotonic() + PATIENCE
    while not path.exists():
        assert time.monotonic() < end
        time.sleep(0.005)


def rank_of(agents: Collection[int], rank: int) -> int:
    """The process that one of these torchruns started as this rank."""
    for folder in Path("/proc").iterdir():
        try:
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            environment = (folder / "environ").read_bytes().split(b"\0")
        except (OSError, ValueError, IndexError):
            continue
        if parent in agents and f"RANK={rank}".encode() in environment:
            return int(folder.name)
    raise AssertionError("no such rank")
