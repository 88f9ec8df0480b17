"""Consistency of ranks: values that must be equal, with a message on the first that differs."""

import json
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch

from ..._version import __version__
from ...errors import ConfigError, DatasetError
from ...json_text import parse_json
from ...raster import native_library
from .process_group import ProcessGroup


def versions() -> dict[str, Any]:
    """Versions and instruction sets that determine the bits of a step, by name."""
    return {
        "gscore": __version__,
        "torch": torch.__version__,
        "numpy": np.__version__,
        "instruction set": native_library.isa(),
        "instruction set of torch": torch.backends.cpu.get_cpu_capability(),
    }


def check_equal(group: ProcessGroup, mine: Mapping[str, Any]) -> None:
    """Compare JSON values by name between ranks.

    Raises:
        ConfigError: a rank differs from rank 0; raised on all ranks.
    """
    first, *others = _all_facts(group, {"facts": dict(mine)})
    for rank, other in enumerate(others, 1):
        ours, theirs = first["facts"], other["facts"]
        for name in sorted(ours.keys() | theirs.keys()):
            if ours.get(name) != theirs.get(name):
                group.notified = True
                raise ConfigError(
                    f"{_name(group, rank)} differs from rank 0 ({group.hosts[0]}) in "
                    f"{name}: {_shown(theirs, name)} there, {_shown(ours, name)} here. All ranks "
                    "need the same options, versions and photos."
                )


@contextmanager
def all_ready(group: ProcessGroup | None) -> Iterator[None]:
    """Context that all ranks enter, and that fails on all of them if it fails on one.

    Raises:
        DatasetError: another rank failed; names the first one.
        Exception: the error of this rank.
    """
    error = None
    try:
        yield
    except Exception as failure:
        if group is None:
            raise
        error = failure
    if group is None:
        return
    all_facts = _all_facts(
        group, {"error": "" if error is None else str(error) or type(error).__name__}
    )
    if error is not None:
        group.notified = True
        raise error
    for rank, other in enumerate(all_facts):
        if other["error"]:
            group.notified = True
            raise DatasetError(f"{_name(group, rank)}: {other['error']}")


def crc_of(tensors: Mapping[str, torch.Tensor]) -> int:
    """CRC-32 of all tensors."""
    found = 0
    for name in sorted(tensors):
        data = tensors[name].detach().contiguous()
        found = zlib.crc32(data.numpy().tobytes() if data.numel() else b"", found)
    return found


def _all_facts(group: ProcessGroup, mine: dict[str, Any]) -> list[dict[str, Any]]:
    return [parse_json(found) for found in group.texts(json.dumps(mine, default=str))]


def _name(group: ProcessGroup, rank: int) -> str:
    return f"Rank {rank} ({group.hosts[rank]})"


def _shown(facts: dict[str, Any], name: str) -> str:
    return str(facts.get(name, "nothing"))[:80]
