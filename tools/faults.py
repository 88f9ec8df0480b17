"""Does to trainings what happens to them, and says what came of it: make faults [KILLS=50].

Each fault is done to real processes in a folder of their own. What counts: the end has the bits of
an undisturbed run, nothing written before is lost, and errors are one sentence.
"""

import argparse
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CAPTURE = ROOT / "examples" / "studio"
OPTIONS = ["--preset", "preview", "--iterations", "120", "--max-splats", "3000", "-r", "100"]
OPTIONS += ["--mask-mode", "none", "--threads", "1", "--checkpoint-seconds", "0.05"]
LIMIT = 600
"""Seconds a process may take on a busy machine."""


class HarmError(Exception):
    """A fault that did harm."""


class CannotError(Exception):
    """A fault that cannot be made here."""


@contextmanager
def file_system(place: Path, options: str) -> Iterator[Path]:
    """A new file system in memory at `place`, with these options of mount."""
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(place)]
    if subprocess.run(mount, capture_output=True).returncode:
        raise CannotError("mounting takes rights that this user does not have")
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", str(place)], check=False)


def command(output: Path, *extra: str, capture: Path = CAPTURE) -> list[str]:
    """A training; with --resume in `extra` one that goes on."""
    given = [] if "--resume" in extra else [str(capture), *OPTIONS]
    return [sys.executable, "-m", "gscore", "train", *given, "-o", str(output), *extra]


def start(arguments: list[str], **options) -> subprocess.Popen:
    """The process, silent."""
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(arguments, cwd=ROOT, text=True, **pipes | options)


def finish(arguments: list[str], **options) -> subprocess.CompletedProcess:
    """Run to the end."""
    process = start(arguments, **options)
    out, err = process.communicate(timeout=LIMIT)
    return subprocess.CompletedProcess(arguments, process.returncode, out, err)


def expect(good: bool, what: str) -> None:
    """Raise unless it is as it should be."""
    if not good:
        raise HarmError(what)


def digest(output: Path) -> str:
    """Of the splats at the end."""
    return hashlib.sha256((output / "point_cloud.ply").read_bytes()).hexdigest()[:16]


def checkpoints(output: Path) -> list[Path]:
    return sorted((output / "checkpoints").glob("step_*.safetensors"))


def is_writing(output: Path, before: int) -> bool:
    """Whether a checkpoint is being written, after another one than those `before`."""
    folder = output / "checkpoints"
    return len(checkpoints(output)) != before and any(folder.glob(".*.tmp"))


def wait_for(process: subprocess.Popen, ready: Callable[[], bool]) -> bool:
    """Whether it came about before the process ended."""
    end = time.monotonic() + LIMIT
    while process.poll() is None and time.monotonic() < end:
        if ready():
            return True
        time.sleep(0.002)
    return False


def sentence(ended: subprocess.CompletedProcess) -> str:
    """The error, which must be one line without a traceback."""
    lines = ended.stderr.strip().splitlines()
    errors = [line for line in lines if "error:" in line]
    expect("Traceback" not in ended.stderr, f"a traceback: {ended.stderr[-300:]}")
    expect(len(errors) == 1, f"{len(errors)} lines of error: {ended.stderr[-300:]}")
    return errors[0].partition("error: ")[2]


class Faults:
    """The faults, each a method; `sound` is the digest of an undisturbed run."""

    def __init__(self, work: Path, *, kills: int, seed: int) -> None:
        self.work = work
        self.kills = kills
        self.random = random.Random(seed)
        ended = finish(command(work / "sound"))
        expect(ended.returncode == 0, f"the undisturbed run failed: {ended.stderr[-500:]}")
        self.sound = digest(work / "sound")

    def resumed(self, output: Path, *extra: str) -> subprocess.CompletedProcess:
        """Go on to the end, which must have the bits of the undisturbed run."""
        ended = finish(command(output, "--resume", *extra))
        expect(ended.returncode == 0, f"resume failed: {ended.stderr[-500:]}")
        expect(digest(output) == self.sound, "the end differs from an undisturbed run")
        expect(not list(output.rglob(".*.tmp")), "temporary files are left")
        return ended

    def kill_at_random_moments(self) -> str:
        """kill -9, half of them while a checkpoint is being written; then resume, to the end."""
        done, writing, before_first = 0, 0, 0
        output = self.work / "killed"
        while done < self.kills:
            extra = ["--resume"] if checkpoints(output) else ["--overwrite"]
            before_first += extra == ["--overwrite"]
            process = start(
                command(output, *extra), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
            number = len(checkpoints(output))
            if done % 2 and wait_for(process, lambda n=number: is_writing(output, n)):
                writing += 1
            else:
                wait_for(process, lambda: (output / ".gscore.lock").exists())
                end = time.monotonic() + self.random.uniform(0, 4)
                wait_for(process, lambda end=end: time.monotonic() > end)
            alive = process.poll() is None
            process.kill()
            process.wait()
            if alive:
                done += 1
            if (output / "point_cloud.ply").exists():  # it came to its end: the next chain
                if not alive:
                    self.resumed(output)
                shutil.rmtree(output)
            elif done % 5 == 0 and checkpoints(output):  # and now and then all the way
                self.resumed(output)
                shutil.rmtree(output)
        if checkpoints(output):
            self.resumed(output)
        return f"{done} kills, {writing} while writing a checkpoint; each chain ended bit-equal"

    def full_disk(self) -> str:
        """A file system of 1 MB."""
        with file_system(self.work / "small", "size=1m") as place:
            output = place / "out"
            ended = finish(command(output))
            said = sentence(ended)
            expect(ended.returncode == 2 and "disk is full" in said, said)
            for path in checkpoints(output):
                path.read_bytes()
            kept = len(checkpoints(output))
            subprocess.run(["mount", "-o", "remount,size=200m", str(place)], check=True)
            if kept:
                self.resumed(output)
            return f"“{said[:60]}...”, {kept} checkpoints kept; resumed after making room"

    def read_only_output(self) -> str:
        """A read-only file system."""
        with file_system(self.work / "fixed", "ro") as place:
            ended = finish(command(place / "out"))
            said = sentence(ended)
            expect(ended.returncode == 2 and "Read-only" in said, said)
            return f"“{said}”"

    def photos_deleted_or_changed(self) -> str:
        """Photos vanish while a run goes on; then one comes back changed."""
        capture, output = self.work / "capture", self.work / "photos"
        shutil.copytree(CAPTURE, capture)
        process = start(command(output, capture=capture), stdout=subprocess.DEVNULL)
        expect(
            wait_for(process, lambda: len(checkpoints(output)) > 0), "it never wrote a checkpoint"
        )
        (capture / "images").rename(capture / "gone")
        _, err = process.communicate(timeout=LIMIT)
        expect("Traceback" not in err, err[-500:])
        first = "ran to its end" if process.returncode == 0 else "stopped with one sentence"
        (capture / "gone").rename(capture / "images")
        photo = sorted((capture / "images").iterdir())[3]
        kept = photo.read_bytes()
        other = sorted((capture / "images").iterdir())[4]
        photo.write_bytes(other.read_bytes())
        ended = finish(command(output, "--resume", "--iterations", "150"))
        said = sentence(ended)
        expect(ended.returncode == 2 and "photos of the capture are not the same" in said, said)
        photo.write_bytes(kept)
        ended = finish(command(output, "--resume", "--iterations", "150"))
        expect(ended.returncode == 0, ended.stderr[-300:])
        return f"gone: {first}; changed: refused by name; restored: went on"

    def two_runs_in_one_folder(self) -> str:
        """The second must leave the first alone."""
        output = self.work / "shared"
        long = command(output, "--iterations", "100000")
        process = start(long, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        expect(wait_for(process, lambda: len(checkpoints(output)) > 0), "it wrote no checkpoint")
        said = sentence(finish(command(output, "--overwrite")))
        expect("in use by another training" in said and str(process.pid) in said, said)
        expect(process.poll() is None and len(checkpoints(output)) > 0, "the first was disturbed")
        process.terminate()
        expect(process.wait(timeout=LIMIT) == 143, "the first did not end in good order")
        return "the second is refused and names the first, which goes on"

    def signals(self) -> str:
        """SIGTERM ends in good order; SIGINT twice ends at once. Both go on."""
        codes = []
        for name, sent in (("term", [signal.SIGTERM]), ("int", [signal.SIGINT, signal.SIGINT])):
            output = self.work / name
            process = start(command(output), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            expect(wait_for(process, lambda o=output: len(checkpoints(o)) > 0), "no checkpoint")
            for number in sent:
                process.send_signal(number)
                time.sleep(0.05)
            codes.append(process.wait(timeout=LIMIT))
            self.resumed(output)
        expect(codes[0] == 143 and codes[1] in (130, -2), f"exit codes {codes}")
        return f"exit codes {codes[0]} and {codes[1]}; resumed bit-equal"

    def closed_pipes(self) -> str:
        """stdin ends: checkpoint and end. stdin and stdout are closed from the start: it trains."""
        output = self.work / "pipes"
        process = start(command(output, "--events", "jsonl"), stdin=subprocess.PIPE)
        expect(wait_for(process, lambda: len(checkpoints(output)) > 0), "no checkpoint")
        process.communicate(timeout=LIMIT)  # closes stdin
        expect(process.returncode == 0, f"exit code {process.returncode}")
        self.resumed(output)
        closed = self.work / "closed"
        line = " ".join(f"'{word}'" for word in command(closed, "--quiet")) + " <&- >&-"
        ended = finish(["sh", "-c", line])
        expect(ended.returncode == 0 and digest(closed) == self.sound, ended.stderr[-500:])
        return "end of stdin: checkpoint, resumed bit-equal; closed from the start: bit-equal"

    def clock_jumps(self) -> str:
        """The wall clock jumps by days, back and forth, at every look."""
        output = self.work / "clock"
        code = (
            "import itertools, sys, time; real, jumps = time.time, itertools.count()\n"
            "time.time = lambda: real() + 86400 * (next(jumps) % 7 - 3)\n"
            "from gscore.commands import main; sys.exit(main(sys.argv[1:]))"
        )
        ended = finish([sys.executable, "-c", code, *command(output)[3:]])
        expect(ended.returncode == 0 and digest(output) == self.sound, ended.stderr[-500:])
        spent = json.loads((output / "metrics.json").read_text())["train_seconds"]
        expect(0 < spent < LIMIT, f"it says that {spent} s were spent")
        return f"bit-equal, {spent:.1f} s of training reported"

    def damaged_files(self) -> str:
        """Bits of the last checkpoint flip; then config.json is cut."""
        output = self.work / "damaged"
        process = start(command(output), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        expect(wait_for(process, lambda: len(checkpoints(output)) > 2), "too few checkpoints")
        process.kill()
        process.wait()
        last = checkpoints(output)[-1]
        raw = bytearray(last.read_bytes())
        raw[-100] ^= 1
        last.write_bytes(raw)
        config = (output / "config.json").read_text()
        (output / "config.json").write_text(config[: len(config) // 2])
        said = sentence(finish(command(output, "--resume")))
        expect("config.json" in said and "not a JSON config file" in said, said)
        (output / "config.json").write_text(config)
        ended = self.resumed(output)
        expect(f"{last.name} is damaged" in ended.stderr, "it does not say so")
        return "config.json: refused by name; checkpoint: told, set aside, resumed bit-equal"


def main() -> int:
    """Run all faults or those named; the exit code is 1 if one did harm."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    names = [name for name in vars(Faults) if not name.startswith("_") and name != "resumed"]
    parser.add_argument("faults", nargs="*", metavar="FAULT", help=", ".join(names))
    args = parser.parse_args()
    os.environ["PYTHONPATH"] = str(ROOT)
    harm = 0
    with tempfile.TemporaryDirectory(prefix="gscore-faults-") as folder:
        faults = Faults(Path(folder), kills=args.kills, seed=args.seed)
        print(f"undisturbed run: {faults.sound}", flush=True)
        for name in args.faults or names:
            began = time.monotonic()
            try:
                outcome, word = getattr(faults, name)(), "passed"
            except CannotError as reason:
                outcome, word = str(reason), "skipped"
            except (HarmError, subprocess.TimeoutExpired) as error:
                outcome, word, harm = str(error), "FAILED", harm + 1
            took = time.monotonic() - began
            print(f"{word:8} {name.replace('_', ' ')}: {outcome} ({took:.0f} s)", flush=True)
    return 1 if harm else 0


if __name__ == "__main__":
    sys.exit(main())
