"""Fault injection into ranks of one training: python tools/break/ranks.py [--kills 20].

Criteria: the result has the bits of undisturbed ranks, no written file is lost, and errors are one
sentence on rank 0, with exit code 2 on all ranks.
"""

import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

from faults import (
    CAPTURE,
    LIMIT,
    OPTIONS,
    checkpoints,
    expect,
    file_system,
    is_writing,
    main,
    outcome,
    start,
    wait_for,
)

RANKS = 2
_DIED = re.compile(r"Signal 9|SIGKILL")


def torchrun(output: Path, *extra: str) -> list[str]:
    """Command line of a distributed training whose ranks torchrun restarts without limit."""
    words = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(RANKS)]
    words += ["--monitor-interval", "0.1", "--max-restarts", "1000", "-m", "gscore", "train"]
    return [sys.executable, *words, str(CAPTURE), *OPTIONS, "-o", str(output), *extra]


def ranks_of(agent: int) -> dict[int, int]:
    """Process ids of a torchrun's ranks, by rank."""
    found = {}
    for folder in Path("/proc").iterdir():
        try:
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            environment = dict(
                entry.split("=", 1)
                for entry in (folder / "environ").read_text(errors="replace").split("\0")
                if "=" in entry
            )
        except (OSError, ValueError, IndexError):
            continue
        if parent == agent and environment.get("RANK", "").isdigit():
            found[int(environment["RANK"])] = int(folder.name)
    return found


class Faults:
    """The faults, one per method."""

    def __init__(self, work: Path, *, kills: int, seed: int) -> None:
        self.work, self.kills, self.random = work, kills, random.Random(seed)
        self._old: set[int] = set()
        output = work / "sound"
        began = time.monotonic()
        self._end(self._start(output))
        self.seconds = time.monotonic() - began
        self.undisturbed = f"undisturbed ranks: {self.seconds:.0f} s"
        self.sound = outcome(output)

    def kill_random_ranks(self) -> str:
        """kill -9 of a random rank at a random moment, or of rank 0 during a checkpoint."""
        output, kills, ended, tally = self.work / "killed", 0, 0, Counter()
        while kills < self.kills:
            process = self._start(output)
            while kills < self.kills and self._kill_one(process, output, tally):
                kills += 1
            self._end(process)
            self._compare(output)
            ended += 1
            shutil.rmtree(output)
        kinds = ", ".join(f"{count} {what}" for what, count in sorted(tally.items()))
        return f"{kills} kills in {ended} runs ({kinds}), all with the same final bits"

    def full_disk(self) -> str:
        """The disk of rank 0 is too small for a second checkpoint."""
        with file_system(self.work / "small", "size=1500k") as place:
            command = torchrun(place / "out")
            command[command.index("1000")] = "0"
            process = start(command, stdout=subprocess.DEVNULL)
            _, err = process.communicate(timeout=LIMIT)
            errors = [line for line in err.splitlines() if "gscore train: error" in line]
            expect(process.returncode != 0 and len(errors) == 1, err[-800:])
            expect("Cannot write" in errors[0] and "disk is full" in err, errors[0])
            expect(len(checkpoints(place / "out")) > 0, "no checkpoint is kept")
            subprocess.run(["mount", "-o", "remount,size=200m", str(place)], check=True)
            self._end(start([*torchrun(place / "out"), "--resume"], stdout=subprocess.DEVNULL))
            self._compare(place / "out")
        message = errors[0].partition("error: ")[2]
        return f"“{message[:60]}...”; the same result after making room"

    def _kill_one(self, process: subprocess.Popen, output: Path, tally: Counter) -> bool:
        """Kill a rank; returns False if the run ended first."""
        # torchrun stops the remaining ranks before it restarts all.
        fresh = wait_for(
            process,
            lambda: (
                len(now := ranks_of(process.pid)) == RANKS and not self._old & set(now.values())
            ),
        )
        if not fresh:
            return False
        victim, moment = self.random.randrange(RANKS), self.random.randrange(3)
        if moment == 0:
            victim, number = 0, len(checkpoints(output))
            if not wait_for(process, lambda: is_writing(output, number)):
                return False
        else:
            end = time.monotonic() + self.random.uniform(0, self.seconds)
            wait_for(process, lambda: time.monotonic() > end)
        pid = ranks_of(process.pid).get(victim)
        if process.poll() is not None or pid is None:
            return False
        self._old = set(ranks_of(process.pid).values())
        os.kill(pid, signal.SIGKILL)
        tally["while a checkpoint was written" if moment == 0 else f"of rank {victim}"] += 1
        return True

    def _are_fresh(self, now: dict[int, int]) -> bool:
        """Whether all ranks are running, without ranks of the previous start."""
        return len(now) == RANKS and not self._old & set(now.values())

    def _start(self, output: Path) -> subprocess.Popen:
        return start(torchrun(output), stdout=subprocess.DEVNULL)

    def _end(self, process: subprocess.Popen) -> None:
        _, err = process.communicate(timeout=LIMIT)
        expect(process.returncode == 0, f"exit code {process.returncode}: {err[-800:]}")
        expect("Traceback" not in err or _DIED.search(err) is not None, err[-800:])

    def _compare(self, output: Path) -> None:
        found = outcome(output)
        others = [name for name, value in self.sound.items() if found[name] != value]
        expect(not others, f"{', '.join(others)} differ from undisturbed ranks")
        expect(not list(output.rglob(".*.tmp")), "temporary files are left")
        expect(not (output / ".torchrun").exists(), "the file for restarts is left")


if __name__ == "__main__":
    os.environ["OMP_NUM_THREADS"] = "1"
    sys.exit(main(Faults, __doc__, kills=20))
