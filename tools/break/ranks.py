"""Fault injection into ranks of one training: python tools/break/ranks.py [--kills 20].

What counts: the end has the bits of ranks that nobody disturbed, nothing written before is lost,
and errors are one sentence on rank 0, with exit code 2 everywhere.
"""

import argparse
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from faults import (
    CAPTURE,
    LIMIT,
    OPTIONS,
    ROOT,
    CannotError,
    HarmError,
    checkpoints,
    expect,
    file_system,
    is_writing,
    outcome,
    start,
    wait_for,
)

RANKS = 2
_DIED = re.compile(r"Signal 9|SIGKILL")


def torchrun(output: Path, *extra: str) -> list[str]:
    """A training by ranks that torchrun starts again however often one dies."""
    words = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(RANKS)]
    words += ["--monitor-interval", "0.1", "--max-restarts", "1000", "-m", "gscore", "train"]
    return [sys.executable, *words, str(CAPTURE), *OPTIONS, "-o", str(output), *extra]


def ranks_of(agent: int) -> dict[int, int]:
    """The processes that a torchrun has started, by rank."""
    found = {}
    for folder in Path("/proc").iterdir():
        try:
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            said = dict(
                entry.split("=", 1)
                for entry in (folder / "environ").read_text(errors="replace").split("\0")
                if "=" in entry
            )
        except (OSError, ValueError, IndexError):
            continue
        if parent == agent and said.get("RANK", "").isdigit():
            found[int(said["RANK"])] = int(folder.name)
    return found


class Faults:
    """The faults, each a method."""

    def __init__(self, work: Path, *, kills: int, seed: int) -> None:
        self.work, self.kills, self.random = work, kills, random.Random(seed)
        self._old: set[int] = set()
        output = work / "sound"
        began = time.monotonic()
        self._end(self._start(output))
        self.seconds = time.monotonic() - began
        self.sound = outcome(output)

    def kill_random_ranks(self) -> str:
        """kill -9 of any rank, at any moment, or while rank 0 writes a checkpoint."""
        output, kills, ended, tally = self.work / "killed", 0, 0, Counter()
        while kills < self.kills:
            process = self._start(output)
            while kills < self.kills and self._kill_one(process, output, tally):
                kills += 1
            self._end(process)
            self._compare(output)
            ended += 1
            shutil.rmtree(output)
        told = ", ".join(f"{count} {what}" for what, count in sorted(tally.items()))
        return f"{kills} kills in {ended} runs ({told}), all of which ended with the same bits"

    def full_disk(self) -> str:
        """The disk of rank 0 is too small for a second checkpoint."""
        with file_system(self.work / "small", "size=1500k") as place:
            command = torchrun(place / "out")
            command[command.index("1000")] = "0"
            process = start(command, stdout=subprocess.DEVNULL)
            _, err = process.communicate(timeout=LIMIT)
            said = [line for line in err.splitlines() if "gscore train: error" in line]
            expect(process.returncode != 0 and len(said) == 1, err[-800:])
            expect("Cannot write" in said[0] and "disk is full" in err, said[0])
            expect(len(checkpoints(place / "out")) > 0, "no checkpoint is kept")
            subprocess.run(["mount", "-o", "remount,size=200m", str(place)], check=True)
            self._end(start([*torchrun(place / "out"), "--resume"], stdout=subprocess.DEVNULL))
            self._compare(place / "out")
        return f"“{said[0].partition('error: ')[2][:60]}...”; the same end after making room"

    def _kill_one(self, process: subprocess.Popen, output: Path, tally: Counter) -> bool:
        """Whether a rank was killed before the run came to its end."""
        # torchrun stops those that are left before it starts all again.
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
        """Whether all ranks are there, none of them of the start before, which torchrun ends."""
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
        expect(not (output / ".torchrun").exists(), "what only restarts need is left")


def main() -> int:
    """Run all faults or those named; the exit code is 1 if one did harm."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    names = [name for name in vars(Faults) if not name.startswith("_")]
    parser.add_argument("faults", nargs="*", metavar="FAULT", help=", ".join(names))
    args = parser.parse_args()
    os.environ |= {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    harm = 0
    with tempfile.TemporaryDirectory(prefix="gscore-ranks-") as folder:
        faults = Faults(Path(folder), kills=args.kills, seed=args.seed)
        print(f"undisturbed ranks: {faults.seconds:.0f} s", flush=True)
        for name in args.faults or names:
            began = time.monotonic()
            try:
                said, word = getattr(faults, name)(), "passed"
            except CannotError as reason:
                said, word = str(reason), "skipped"
            except (HarmError, subprocess.TimeoutExpired) as error:
                said, word, harm = str(error), "FAILED", harm + 1
            took = time.monotonic() - began
            print(f"{word:8} {name.replace('_', ' ')}: {said} ({took:.0f} s)", flush=True)
    return 1 if harm else 0


if __name__ == "__main__":
    sys.exit(main())
