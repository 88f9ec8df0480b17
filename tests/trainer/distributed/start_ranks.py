"""Ranks started as torchrun starts them, each with its own arguments, and their output."""

import os
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from tests.forked import Forked

ROOT = Path(__file__).parents[3]
PATIENCE = 240
"""Seconds that all ranks together may take."""


class Ended(NamedTuple):
    """Exit code and output of a rank."""

    code: int
    out: str
    err: str


def start(*arguments: Sequence[object]) -> list[Ended]:
    """Run `python ARGUMENTS` once for each rank and wait for all."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    ranks = []
    for rank, words in enumerate(arguments):
        here = {"RANK": rank, "LOCAL_RANK": rank, "MASTER_PORT": port}
        all_ = {"WORLD_SIZE": len(arguments), "LOCAL_WORLD_SIZE": len(arguments)}
        environment = {name: str(value) for name, value in (here | all_).items()}
        environment |= {"MASTER_ADDR": "127.0.0.1", "OMP_NUM_THREADS": "1"}
        ranks.append(Forked([*map(str, words)], env=os.environ | environment, cwd=ROOT))
    try:
        reported = [rank.communicate(timeout=PATIENCE) for rank in ranks]
        codes = [rank.wait() for rank in ranks]
    finally:
        for rank in ranks:
            rank.close()
    return [Ended(code, *both) for code, both in zip(codes, reported, strict=True)]
