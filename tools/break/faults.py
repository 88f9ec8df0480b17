"""Fault injection into trainings, with a report of the results: make faults [KILLS=50].

Each fault is injected into real processes in their own folder. Criteria: the result has the bits of
an undisturbed run (splats, losses of all steps, evaluation), no written file is lost, and errors
are one sentence.
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
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from gscore.trainer.files.checkpoint import load

ROOT = Path(__file__).resolve().parents[2]
CAPTURE = ROOT / "examples" / "studio"
OPTIONS = ["--preset", "preview", "--iterations", "120", "--max-splats", "3000", "-r", "100"]
OPTIONS += ["--mask-mode", "none", "--threads", "1", "--checkpoint-seconds", "0.05"]
LIMIT = 600
"""Time limit of a process on a busy machine, s."""
LAST = Path("checkpoints") / "step_00000120.safetensors"
"""Checkpoint after the last step, written before the results."""
RESULTS = ("point_cloud.ply", "metrics.json", "report.html")


class HarmError(Exception):
    """A violated criterion."""


class CannotError(Exception):
    """A fault that cannot be injected on this machine."""


@contextmanager
def file_system(place: Path, options: str) -> Iterator[Path]:
    """A new file system in memory at `place`, with these mount options."""
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(place)]
    if subprocess.run(mount, capture_output=True).returncode:
        raise CannotError("mounting needs rights that this user does not have")
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", str(place)], check=False)


def command(output: Path, *extra: str, capture: Path = CAPTURE) -> list[str]:
    """Command line of a training, or of a resumed one with --resume in `extra`."""
    given = [] if "--resume" in extra else [str(capture), *OPTIONS]
    return [sys.executable, "-m", "gscore", "train", *given, "-o", str(output), *extra]


def start(arguments: list[str], **options) -> subprocess.Popen:
    """Start a process with captured output."""
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(arguments, cwd=ROOT, text=True, **pipes | options)


def finish(arguments: list[str], **options) -> subprocess.CompletedProcess:
    """Run a process to its end."""
    process = start(arguments, **options)
    out, err = process.communicate(timeout=LIMIT)
    return subprocess.CompletedProcess(arguments, process.returncode, out, err)


def expect(good: bool, what: str) -> None:
    """Raise HarmError unless `good`."""
    if not good:
        raise HarmError(what)


def outcome(output: Path) -> dict[str, str]:
    """Digests of a run's results: splats, metrics without times and memory, and file names."""
    missing = [name for name in RESULTS if not (output / name).is_file()]
    expect(not missing, f"not written: {', '.join(missing)}")
    metrics = json.loads((output / "metrics.json").read_text())
    views = [{k: v for k, v in view.items() if k != "render_seconds"} for view in metrics["views"]]
    history = [[entry[key] for key in ("step", "loss", "splats")] for entry in metrics["history"]]
    evaluated = [views, metrics["psnr"], metrics["ssim"], metrics["reason"], history]
    whole = (output / "report.html").read_text().rstrip().endswith("</html>")
    found = {"point_cloud.ply": (output / "point_cloud.ply").read_bytes()}
    found["metrics.json"] = json.dumps(evaluated).encode()
    found["report.html"] = b"whole" if whole else b"cut"
    names = sorted(path.name for path in output.rglob("*") if path.suffix != ".damaged")
    found["names of files"] = " ".join(names).encode()
    return {name: hashlib.sha256(raw).hexdigest()[:16] for name, raw in found.items()}


def checkpoints(output: Path) -> list[Path]:
    return sorted((output / "checkpoints").glob("step_*.safetensors"))


def is_writing(output: Path, before: int) -> bool:
    """Whether a new checkpoint is being written, when the number of others is not `before`."""
    folder = output / "checkpoints"
    return len(checkpoints(output)) != before and any(folder.glob(".*.tmp"))


def written(path: Path) -> int:
    """Modification time, ns; 0 if the file does not exist."""
    try:
        return path.stat().st_mtime_ns
    except FileNotFoundError:
        return 0


def stage(output: Path) -> str:
    """Stage at which a killed run resumes: before, between or after the steps."""
    if (output / LAST).exists():
        return "results"
    return "steps" if checkpoints(output) else "begin"


def wait_for(process: subprocess.Popen, ready: Callable[[], bool]) -> bool:
    """Wait for `ready`; returns False if the process ended first."""
    end = time.monotonic() + LIMIT
    while process.poll() is None and time.monotonic() < end:
        if ready():
            return True
        time.sleep(0.002)
    return False


def pause(process: subprocess.Popen, seconds: float) -> None:
    """Wait for `seconds`, or until the process ends."""
    end = time.monotonic() + seconds
    wait_for(process, lambda: time.monotonic() > end)


def sentence(ended: subprocess.CompletedProcess) -> str:
    """The error message, which must be one line without a traceback."""
    lines = ended.stderr.strip().splitlines()
    errors = [line for line in lines if "error:" in line]
    expect("Traceback" not in ended.stderr, f"a traceback: {ended.stderr[-300:]}")
    expect(len(errors) == 1, f"{len(errors)} lines of error: {ended.stderr[-300:]}")
    return errors[0].partition("error: ")[2]


class Faults:
    """The faults, one per method; `sound` is the outcome of an undisturbed run."""

    def __init__(self, work: Path, *, kills: int, seed: int) -> None:
        self.work = work
        self.kills = kills
        self.random = random.Random(seed)
        output = work / "sound"
        process = start(command(output), stdout=subprocess.DEVNULL)
        wait_for(process, lambda: (output / ".gscore.lock").exists())
        began = time.monotonic()
        _, err = process.communicate(timeout=LIMIT)
        self.seconds = time.monotonic() - began
        expect(process.returncode == 0, f"the undisturbed run failed: {err[-500:]}")
        self.results_seconds = (written(output / "report.html") - written(output / LAST)) / 1e9
        self.sound = outcome(output)
        self.undisturbed = f"undisturbed run: splats {self.sound['point_cloud.ply']}"

    def _compare(self, output: Path) -> None:
        """Check that the outcome equals that of the undisturbed run, without temporary files."""
        found = outcome(output)
        others = [name for name, value in self.sound.items() if found[name] != value]
        expect(not others, f"{', '.join(others)} differ from an undisturbed run")
        expect(not list(output.rglob(".*.tmp")), "temporary files are left")

    def _resumed(self, output: Path, *extra: str) -> subprocess.CompletedProcess:
        """Resume to the end and compare with the undisturbed run."""
        ended = finish(command(output, "--resume", *extra))
        expect(ended.returncode == 0, f"resume failed: {ended.stderr[-500:]}")
        self._compare(output)
        return ended

    def _again(self, output: Path) -> None:
        """Resume, or restart without a checkpoint, and compare."""
        if checkpoints(output):
            self._resumed(output)
            return
        ended = finish(command(output, "--overwrite"))
        expect(ended.returncode == 0, f"restart failed: {ended.stderr[-500:]}")
        self._compare(output)

    def kill_at_random_moments(self) -> str:
        """kill -9 at a random moment, while a checkpoint is written, or while results are written.

        After each kill a copy of the folder is resumed to the end and compared; the next kill then
        hits the original folder. A folder with all steps is deleted every second time, so that runs
        that only rewrite results are killed too.
        """
        output, copy = self.work / "killed", self.work / "copy"
        moments = [self._any_moment, self._checkpoint_moment, self._results_moment]
        kills, tally = 0, Counter()
        while kills < self.kills:
            extra = ["--resume"] if checkpoints(output) else ["--overwrite"]
            process = start(
                command(output, *extra), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
            moments[kills % len(moments)](process, output)
            process.kill()
            if process.wait() != -signal.SIGKILL:  # it ended before the kill
                expect(process.returncode == 0, f"a run ended with {process.returncode}")
                self._compare(output)
                shutil.rmtree(output)
                continue
            kills += 1
            tally[stage(output)] += 1
            tally["half a checkpoint"] += any((output / "checkpoints").glob(".*.tmp"))
            if output.exists():
                shutil.copytree(output, copy)
            self._again(copy)
            tally["same"] += 1
            shutil.rmtree(copy)
            if stage(output) == "results" and self.random.random() < 0.5:
                shutil.rmtree(output)
        return (
            f"{tally['same']} of {kills} ended with the same splats and metrics: "
            f"{tally['begin']} restarted without a checkpoint, {tally['steps']} resumed in the "
            f"middle and {tally['results']} after the last step; "
            f"{tally['half a checkpoint']} kills left a partial checkpoint"
        )

    def _any_moment(self, process: subprocess.Popen, output: Path) -> None:
        wait_for(process, lambda: (output / ".gscore.lock").exists())
        pause(process, self.random.uniform(0, self.seconds))

    def _checkpoint_moment(self, process: subprocess.Popen, output: Path) -> None:
        number = len(checkpoints(output))
        wait_for(process, lambda: is_writing(output, number))

    def _results_moment(self, process: subprocess.Popen, output: Path) -> None:
        """Between the last checkpoint and the end of the process."""
        before = written(output / LAST)
        wait_for(process, lambda: written(output / LAST) != before)
        pause(process, self.random.uniform(0, self.results_seconds))

    def full_disk(self) -> str:
        """Disks too small for a checkpoint, for a second one, for the splats after the last."""
        results = []
        for size, extra, steps in (
            ("400k", [], []),
            ("1500k", [], None),
            ("1200k", ["--checkpoint-seconds", "0"], [120]),
        ):
            with file_system(self.work / size, f"size={size}") as place:
                output = place / "out"
                ended = finish(command(output, *extra))
                message = sentence(ended)
                expect(ended.returncode == 2 and "disk is full" in message, message)
                kept = [load(path).steps for path in checkpoints(output)]
                good = len(kept) > 0 if steps is None else kept == steps
                expect(good, f"with {size} the checkpoints of these steps are kept: {kept}")
                results.append(f"{size}: {len(kept)} kept")
                subprocess.run(["mount", "-o", "remount,size=200m", str(place)], check=True)
                self._again(output)
        kept = ", ".join(results)
        return f"“{message[:60]}...”; {kept} and complete; the same result after making room"

    def read_only_output(self) -> str:
        """A read-only file system."""
        with file_system(self.work / "fixed", "ro") as place:
            ended = finish(command(place / "out"))
            message = sentence(ended)
            expect(ended.returncode == 2 and "the disk is read-only" in message, message)
            return f"“{message}”"

    def photos_deleted_or_changed(self) -> str:
        """Photos are deleted during a run; then one is changed."""
        capture, output = self.work / "capture", self.work / "photos"
        shutil.copytree(CAPTURE, capture)
        process = start(command(output, capture=capture), stdout=subprocess.DEVNULL)
        expect(wait_for(process, lambda: len(checkpoints(output)) > 0), "it wrote no checkpoint")
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
        message = sentence(ended)
        changed = "photos of the capture are not the same" in message
        expect(ended.returncode == 2 and changed, message)
        photo.write_bytes(kept)
        ended = finish(command(output, "--resume", "--iterations", "150"))
        expect(ended.returncode == 0, ended.stderr[-300:])
        return f"deleted: {first}; changed: rejected by name; restored: resumed"

    def two_runs_in_one_folder(self) -> str:
        """The second run must not disturb the first."""
        output = self.work / "shared"
        long = command(output, "--iterations", "100000")
        process = start(long, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        expect(wait_for(process, lambda: len(checkpoints(output)) > 0), "it wrote no checkpoint")
        message = sentence(finish(command(output, "--overwrite")))
        good = "in use by another training" in message and str(process.pid) in message
        expect(good, message)
        expect(process.poll() is None and len(checkpoints(output)) > 0, "the first was disturbed")
        process.terminate()
        expect(process.wait(timeout=LIMIT) == 143, "the first did not stop in an orderly way")
        return "the second is rejected and names the first, which continues"

    def signals(self) -> str:
        """SIGTERM and SIGHUP stop orderly, SIGINT twice immediately; all can be resumed."""
        codes = []
        for name, sent in (
            ("term", [signal.SIGTERM]),
            ("hup", [signal.SIGHUP, signal.SIGHUP]),
            ("int", [signal.SIGINT, signal.SIGINT]),
        ):
            output = self.work / name
            process = start(command(output), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            expect(wait_for(process, lambda o=output: len(checkpoints(o)) > 0), "no checkpoint")
            for number in sent:
                process.send_signal(number)
                time.sleep(0.05)
            codes.append(process.wait(timeout=LIMIT))
            self._resumed(output)
        expect(codes == [143, 129, 130], f"exit codes {codes}")
        return f"exit codes {', '.join(map(str, codes))}; resumed bit-equal"

    def closed_pipes(self) -> str:
        """A closed stdin or stdout: checkpoint and stop. All closed from the start: it trains."""
        output = self.work / "unread"
        process = start(command(output, "--events", "jsonl"))
        expect(wait_for(process, lambda: len(checkpoints(output)) > 0), "no checkpoint")
        process.stdout.close()
        expect(process.wait(timeout=LIMIT) == 141, f"exit code {process.returncode}")
        expect("Traceback" not in process.stderr.read(), "a traceback")
        self._resumed(output)
        output = self.work / "pipes"
        process = start(command(output, "--events", "jsonl"), stdin=subprocess.PIPE)
        expect(wait_for(process, lambda: len(checkpoints(output)) > 0), "no checkpoint")
        process.communicate(timeout=LIMIT)  # closes stdin
        expect(process.returncode == 0, f"exit code {process.returncode}")
        self._resumed(output)
        closed = self.work / "closed"
        line = " ".join(f"'{word}'" for word in command(closed)) + " <&- >&- 2>&-"
        ended = finish(["sh", "-c", line])
        expect(ended.returncode == 0, ended.stderr[-500:])
        self._compare(closed)
        return "end of either: checkpoint, resumed bit-equal; closed from the start: bit-equal"

    def clock_jumps(self) -> str:
        """The wall clock jumps by days, back and forth, at every reading."""
        output = self.work / "clock"
        code = (
            "import itertools, sys, time; real, jumps = time.time, itertools.count()\n"
            "time.time = lambda: real() + 86400 * (next(jumps) % 7 - 3)\n"
            "from gscore.commands import main; sys.exit(main(sys.argv[1:]))"
        )
        ended = finish([sys.executable, "-c", code, *command(output)[3:]])
        expect(ended.returncode == 0, ended.stderr[-500:])
        self._compare(output)
        spent = json.loads((output / "metrics.json").read_text())["train_seconds"]
        expect(0 < spent < LIMIT, f"reported training time {spent} s")
        return f"bit-equal, {spent:.1f} s of training reported"

    def damaged_files(self) -> str:
        """A bit of the last checkpoint flips; then config.json is truncated."""
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
        message = sentence(finish(command(output, "--resume")))
        expect("config.json" in message and "not a JSON config file" in message, message)
        (output / "config.json").write_text(config)
        ended = self._resumed(output)
        expect(f"{last.name} is damaged" in ended.stderr, "no warning on the checkpoint")
        return "config.json: rejected by name; checkpoint: reported, skipped, resumed bit-equal"


def main(faults_of: type, description: str | None, *, kills: int) -> int:
    """Inject the faults, the public methods of a class, or those given as arguments.

    Args:
        faults_of: Class of the faults; `undisturbed` of an instance describes the runs that are
            compared with.
        description: Of the program.
        kills: Default number of kills.

    Returns:
        Exit code: 1 if a criterion was violated.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--kills", type=int, default=kills)
    parser.add_argument("--seed", type=int, default=0)
    names = [name for name in vars(faults_of) if not name.startswith("_")]
    parser.add_argument("faults", nargs="*", metavar="FAULT", help=", ".join(names))
    args = parser.parse_args()
    for number in (signal.SIGINT, signal.SIGHUP):
        # A background shell ignores these signals, which trainings would inherit.
        signal.signal(number, signal.default_int_handler)
    os.environ["PYTHONPATH"] = str(ROOT)
    harm = 0
    with tempfile.TemporaryDirectory(prefix="gscore-faults-") as folder:
        faults = faults_of(Path(folder), kills=args.kills, seed=args.seed)
        print(faults.undisturbed, flush=True)
        for name in args.faults or names:
            began = time.monotonic()
            try:
                text, word = getattr(faults, name)(), "passed"
            except CannotError as reason:
                text, word = str(reason), "skipped"
            except (HarmError, subprocess.TimeoutExpired) as error:
                text, word, harm = str(error), "FAILED", harm + 1
            took = time.monotonic() - began
            print(f"{word:8} {name.replace('_', ' ')}: {text} ({took:.0f} s)", flush=True)
    return 1 if harm else 0


if __name__ == "__main__":
    sys.exit(main(Faults, __doc__, kills=50))
