"""Process group of one training, started by torchrun: the only module that communicates.

Messages are numbers and JSON, never pickled objects. A lost process is detected by its closed
connection; there is no timeout between steps, because rank 0 may be paused.
"""

import json
import os
import platform
import struct
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import timedelta
from types import TracebackType
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from ...errors import ConfigError, GsError
from ...json_text import parse_json
from ...raster.memory import empty

BEGIN, STEP, COLLECT, RESTORE, END = "begin", "step", "collect", "restore", "end"
"""Commands of rank 0, `do` of JSON messages that the other ranks run: read the photos and create a
trainer; take a step; send the state that a checkpoint needs; restore the state and the tensors that
follow; end, because the run is complete or rank 0 failed."""
_PATIENCE = timedelta(days=7)
"""Rank 0 may be paused, or measure, while the others wait."""
_MEETING = timedelta(minutes=10)
"""Timeout of the rendezvous at the start, after which a missing rank has failed."""
_DTYPES = {
    str(dtype): dtype
    for dtype in (torch.float32, torch.float64, torch.int64, torch.int32, torch.uint8)
}
_LETTER = 120
"""Bytes sent along with the length; step commands are shorter, so they need one broadcast."""
_WORLD, _RANK, _LOCAL = "WORLD_SIZE", "RANK", "LOCAL_WORLD_SIZE"
_ENDED = "gscore ended"
_RESTARTS = "TORCHELASTIC_RESTART_COUNT"
_Found = TypeVar("_Found")


_SPARE = 1.25
"""Allocated size relative to the requested size, because requests vary from step to step."""


class ScratchBuffer:
    """Memory of int32 words that grows on demand."""

    def __init__(self) -> None:
        self._words = empty(0, dtype=torch.int32)

    def of(self, rows: int, width: int) -> Tensor:
        """Return [rows, width] int32, uninitialised; invalidates earlier results."""
        count = rows * width
        if len(self._words) < count:
            self._words = empty(int(_SPARE * count), dtype=torch.int32)
        return self._words[:count].view(rows, width)


class RankLostError(GsError):
    """Another process is gone, or does not answer."""


def world_size() -> int:
    """Number of processes of the training, from torchrun's environment variables; 1 without them.

    Raises:
        ConfigError: a variable is not a number.
    """
    return _number(_WORLD, 1) if _RANK in os.environ else 1


def restarted() -> bool:
    """Return whether torchrun restarted this process because another one was lost."""
    return world_size() >= 1 and _number(_RESTARTS, 0) > 0


def threads_of_rank(cores: int) -> int:
    """CPU threads for each process of this machine with `cores` cores."""
    return max(1, cores // _number(_LOCAL, 1))


def _number(name: str, default: int) -> int:
    text = os.environ.get(name, str(default))
    if not text.isascii() or not text.isdigit():
        raise ConfigError(f"The environment variable {name} must be a number, got {text[:40]!r}.")
    return int(text)


class ProcessGroup:
    """All ranks of a training, from the view of one. A context that leaves the group at its end."""

    def __init__(self) -> None:
        """Join the group.

        Raises:
            ConfigError: an environment variable is not a number.
            GsError: the other ranks cannot be reached.
        """
        import torch.distributed as dist

        self.rank = _number(_RANK, 0)
        """Number of this process, from 0."""
        self.size = world_size()
        """Number of processes."""
        self.sent = 0
        """Bytes of rows that this process has sent to others."""
        self._waited = 0.0
        self.batches = 0
        """Steps that this process has completed with the others."""
        self.account = (0.0, 0.0, 0.0)
        """Totals of this process over completed steps: bytes sent, seconds of work, and seconds of
        communication and waiting."""
        self.accounts = np.zeros((self.size, 3))
        """[size, 3] `account` of each rank, before the last step."""
        self.in_step = False
        """True if the others may be waiting for data of this rank."""
        self.notified = False
        """True if the others have been notified of the end."""
        self._dist = dist
        try:
            # torch documents both names, but does not list them as exported.
            meeting = dist.rendezvous("env://", timeout=_MEETING)  # pyright: ignore[reportPrivateImportUsage]
            self._kept = store = next(meeting)[0]
            self.ended = store.check([_ENDED])
            """True if the work was complete before torchrun restarted a rank lost during exit."""
            # torchrun keeps the addresses of dead ranks, so each restart uses its own prefix.
            room = f"gscore {_number(_RESTARTS, 0)}"
            store = dist.PrefixStore(room, store)  # pyright: ignore[reportPrivateImportUsage]
            self._store = store
            dist.init_process_group(
                "gloo", store=store, rank=self.rank, world_size=self.size, timeout=_PATIENCE
            )
        except (RuntimeError, ValueError) as error:
            where = f"{os.environ.get('MASTER_ADDR', '?')}:{os.environ.get('MASTER_PORT', '?')}"
            raise GsError(
                f"Rank {self.rank} ({platform.node()}) cannot meet the others at {where}: "
                f"{_first_line(error)} Check `--master-addr`, `--master-port` or `--rdzv-endpoint` "
                "of torchrun, and at GLOO_SOCKET_IFNAME, the network to use."
            ) from error
        self.hosts = self.texts(platform.node())
        """The names of the ranks' machines."""

    def __enter__(self) -> "ProcessGroup":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._dist.is_initialized():
            self._dist.destroy_process_group()

    @property
    def is_rank0(self) -> bool:
        """True if this is rank 0, which decides, writes files and emits events."""
        return self.rank == 0

    @contextmanager
    def stepping(self) -> Iterator[None]:
        """Context of a step, in which all ranks wait for each other."""
        self.in_step = True
        sent, waited, began = self.sent, self._waited, time.perf_counter()
        yield
        self.in_step = False
        self.batches += 1
        waited = self._waited - waited
        worked = time.perf_counter() - began - waited
        before = self.account
        self.account = (before[0] + self.sent - sent, before[1] + worked, before[2] + waited)

    def take_turn(self) -> int:
        """A number unique among ranks: 0, 1 and so on, in the order of the calls.

        Raises:
            RankLostError: the shared counter is gone.
        """
        return self._collective(lambda: self._store.add("turn", 1)) - 1

    def note_end(self) -> None:
        """Record for restarted processes that the work is complete."""
        self._collective(lambda: self._kept.set(_ENDED, "1"))

    def broadcast(self, order: Mapping[str, Any]) -> None:
        """Send a command from rank 0 to the others, as JSON values; no effect on other ranks."""
        if self.is_rank0:
            self._broadcast(json.dumps(order).encode())

    def shutdown(self, *, failed: bool = False) -> None:
        """Send the end command from rank 0, unless the others have been notified."""
        if not (self.notified or self.in_step):
            self.notified = True
            self.broadcast({"do": END, "failed": failed})

    def receive(self) -> dict[str, Any]:
        """Wait for a command of rank 0."""
        return parse_json(self._broadcast(b""))

    def all_gather(self, mine: Sequence[float]) -> np.ndarray:
        """[size, K] float64: the K numbers of each rank."""
        return np.stack([part.numpy() for part in self._all(_tensor(mine))])

    def texts(self, mine: str) -> list[str]:
        """The text of each rank."""
        letters = torch.tensor(list(mine.encode()), dtype=torch.int32, device="cpu")
        return [
            bytes(part.flatten().tolist()).decode()
            for part in self.rows(letters[:, None], ScratchBuffer())
        ]

    def rows(
        self, mine: Tensor, room: ScratchBuffer, *, all_sizes: np.ndarray | None = None
    ) -> list[Tensor]:
        """The rows of each rank: `mine` is [M, K] int32, M may differ. Rows of others are stored
        in `room`; `all_sizes` as in `all_to_all`."""
        others = [0 if rank == self.rank else 1 for rank in range(self.size)]
        copies = mine if self.size == 2 else mine.repeat(self.size - 1, 1)
        found = self.all_to_all(
            copies, [len(mine) * other for other in others], room, all_sizes=all_sizes
        )
        return [part if other else mine for part, other in zip(found, others, strict=True)]

    def all_to_all(
        self,
        mine: Tensor,
        sizes: Sequence[int],
        room: ScratchBuffer,
        *,
        all_sizes: np.ndarray | None = None,
    ) -> list[Tensor]:
        """Send `sizes[r]` rows of `mine`, [M, K] int32, to each rank r, in the order of the ranks;
        returns the rows received from each rank, stored in `room`.

        `all_sizes`: [size, size] `sizes` of each rank, if known; None: they are exchanged first.
        """
        all_sizes = self.all_gather(sizes) if all_sizes is None else all_sizes
        counts = all_sizes[:, self.rank].astype(int).tolist()
        found = room.of(sum(counts), mine.shape[1])
        self.sent += (len(mine) - sizes[self.rank]) * mine.shape[1] * mine.element_size()
        self._collective(lambda: self._dist.all_to_all_single(found, mine, counts, list(sizes)))
        return list(found.split(counts))

    def to_first(self, mine: Tensor) -> list[Tensor]:
        """Gather on rank 0: the tensors of the others, shaped as its own; empty on other ranks."""
        found = [torch.empty_like(mine) for _ in range(self.size)] if self.is_rank0 else None
        if mine.numel():
            self._collective(lambda: self._dist.gather(mine.contiguous(), found, dst=0))
        return found[1:] if found else []

    def share(self, tensors: Mapping[str, Tensor] | None) -> dict[str, Tensor]:
        """Broadcast the tensors of rank 0 by name; other ranks pass None."""
        if tensors is not None:
            tensors = {name: t.contiguous() for name, t in tensors.items()}
            head = {name: [str(t.dtype), list(t.shape)] for name, t in tensors.items()}
            self._broadcast(json.dumps(head).encode())
        else:
            head = parse_json(self._broadcast(b""))
            tensors = {name: empty(*s, dtype=_DTYPES[dtype]) for name, (dtype, s) in head.items()}
        for tensor in tensors.values():
            if tensor.numel():
                self._collective(lambda data=tensor: self._dist.broadcast(data, src=0))
        return dict(tensors)

    def _all(self, mine: Tensor) -> list[Tensor]:
        found = [torch.empty_like(mine) for _ in range(self.size)]
        if mine.numel():
            self._collective(lambda: self._dist.all_gather(found, mine.contiguous()))
        return found

    def _broadcast(self, data: bytes) -> bytes:
        """Broadcast bytes of rank 0: first the length and the first bytes, then the rest."""
        letter = bytearray(struct.pack("<q", len(data)) + data[:_LETTER]).ljust(8 + _LETTER)
        first = torch.frombuffer(letter, dtype=torch.uint8)
        self._collective(lambda: self._dist.broadcast(first, src=0))
        length = struct.unpack_from("<q", letter)[0]
        rest = bytearray(data[_LETTER:]) if self.is_rank0 else bytearray(max(length - _LETTER, 0))
        if rest:
            more = torch.frombuffer(rest, dtype=torch.uint8)
            self._collective(lambda: self._dist.broadcast(more, src=0))
        return bytes(letter[8 : 8 + length] + rest)

    def _collective(self, call: Callable[[], _Found]) -> _Found:
        """Result of `call`, a collective operation.

        Raises:
            RankLostError: another rank is gone.
        """
        began = time.perf_counter()
        try:
            return call()
        except RuntimeError as error:
            raise RankLostError(
                "A rank of this training is gone; torchrun reports which and why. With "
                "`--max-restarts` torchrun resumes from the last checkpoint by itself, otherwise "
                f"run the same command with `--resume`. ({_first_line(error)})"
            ) from error
        finally:
            self._waited += time.perf_counter() - began


def _tensor(numbers: Sequence[float]) -> Tensor:
    return torch.from_numpy(np.asarray(numbers, np.float64))


def _first_line(error: Exception) -> str:
    return str(error).strip().split("\n")[0][:200]
