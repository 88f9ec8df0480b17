"""Rank traffic: network use of a distributed training: python tools/measure/rank_traffic.py.

Trains with 1, 2 and 4 ranks of one thread on this machine, then with two ranks over a simulated
slow network: each collective operation pauses for the latency of a message (half a round trip), for
a retransmission with some probability, and for its bytes at a limited bandwidth. Prints a table of
bytes and seconds per batch. Other arguments are options of `gscore train`.
"""

import argparse
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[2]
SENT_AGAIN = 0.2
"""Minimum retransmission timeout of TCP on Linux, s (RFC 6298)."""


class Network(NamedTuple):
    """A simulated network between two machines."""

    delay_ms: float = 0.0
    """Latency of a message, one way."""
    loss: float = 0.0
    """Share of messages that are lost and retransmitted."""
    mbit: float = 0.0
    """Bandwidth, Mbit/s; 0: unlimited."""

    @property
    def words(self) -> str:
        """Description for a row of the table."""
        parts = [f"{self.delay_ms:g} ms"] if self.delay_ms else []
        parts += [f"{self.loss:.1%} lost"] if self.loss else []
        parts += [f"{self.mbit:g} Mbit/s"] if self.mbit else []
        return ", ".join(parts) or "this machine"


def rank(network: Network, arguments: list[str]) -> int:
    """Run gscore as one of the ranks over a simulated network; returns the exit code."""
    from gscore.commands import main
    from gscore.trainer.distributed.process_group import ProcessGroup

    collective, chance = ProcessGroup._collective, random.Random(0)

    def slowly(group: ProcessGroup, call: Callable[[], Any]) -> Any:
        def over_the_network() -> Any:
            pause = network.delay_ms / 1000
            pause += SENT_AGAIN if chance.random() < network.loss else 0.0
            pause += (group.sent - paid[0]) * 8e-6 / network.mbit if network.mbit else 0.0
            paid[0] = group.sent
            time.sleep(pause)
            return call()

        return collective(group, over_the_network)

    paid = [0]
    ProcessGroup._collective = slowly
    return main(arguments)


def measure(capture: Path, out: Path, ranks: int, network: Network, more: list[str]) -> list[str]:
    """Cells of a row of the table."""
    words = ["train", str(capture), "-o", str(out), "--overwrite", "--quiet", "--threads", "1"]
    words += more
    line = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(ranks)]
    line += [__file__, "--rank", json.dumps(network), "--", *words]
    subprocess.run([sys.executable, *line], check=True, cwd=ROOT, stderr=subprocess.DEVNULL)
    metrics = json.loads((out / "metrics.json").read_text())
    photo = metrics["train_seconds"] / metrics["steps"]
    traffic = metrics.get("ranks")
    if traffic is None:
        return [str(ranks), network.words, "0", "", "", f"{photo:.3f}"]
    return [
        str(ranks),
        network.words,
        f"{max(traffic['sent_bytes_per_batch']) / 1e6:.2f}",
        f"{max(traffic['worked_seconds_per_batch']):.3f}",
        f"{min(traffic['waited_seconds_per_batch']):.3f}",
        f"{photo:.3f}",
    ]


def main() -> int:
    """Measure, or run as a rank of a measurement."""
    if sys.argv[1:2] == ["--rank"]:
        return rank(Network(*json.loads(sys.argv[2])), sys.argv[4:])
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--capture", type=Path, default=ROOT / "examples/studio")
    parser.add_argument("--only-networks", action="store_true")
    args, more = parser.parse_known_args()
    os.environ |= {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    plans = [] if args.only_networks else [(ranks, Network()) for ranks in (1, 2, 4)]
    plans += [(2, Network(delay_ms=delay)) for delay in (1, 10, 50)]
    plans += [(2, Network(delay_ms=1, loss=loss)) for loss in (0.001, 0.01)]
    plans += [(2, Network(delay_ms=1, mbit=mbit)) for mbit in (10000, 1000, 100)]
    print("| ranks | network | MB per batch | works, s | waits, s | s per photo |", flush=True)
    print("|---|---|---|---|---|---|", flush=True)
    with tempfile.TemporaryDirectory(prefix="gscore-ranks-") as folder:
        for ranks, network in plans:
            cells = measure(args.capture, Path(folder) / "run", ranks, network, more)
            print(f"| {' | '.join(cells)} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
