"""A program with the protocol of `gscore train --events jsonl` that plays a script.

`fake_trainer.py SCRIPT.json` where the script is a list of steps:
    {"say": EVENT}         print an event as a line of JSON
    {"raw": TEXT}          print a text as it is
    {"stderr": TEXT}       print to the error output
    {"huge": N}            print a line of N bytes
    {"sleep": SECONDS}     print nothing for a while
    {"write": [PATH, TEXT]} write a file
    {"loop": [N, STEPS]}   do STEPS N times; "$i" in events is the number of the round
    {"await": COMMAND}     wait for a line on stdin and print it as a warning event
    {"follow": SECONDS}    act on stdin like the trainer: progress, pause, resume, snapshot, stop
    {"exit": CODE}         end with this code
    {"signal": NUMBER}     end by this signal
Used instead of a Python that has gscore: the add-on's arguments `-u -m gscore ...` are written to
the file `SCRIPT.args`.
"""

import json
import os
import queue
import sys
import threading
import time
from pathlib import Path

STARTED = {
    "event": "started",
    "source": "capture",
    "output": "$out",
    "iterations": 100,
    "step": 0,
    "train_views": 7,
    "test_views": 1,
    "splats": 1000,
    "width": 64,
    "height": 48,
    "isa": "scalar",
    "threads": 1,
    "config": {},
}
"""The first event of a run."""


CONFIG = {"write": ["$out/config.json", '{"gscore": "0.1.0", "data": {}, "train": {}}']}
"""The file that every training writes first."""


def step(number: int | str, **changes: object) -> dict:
    """A step of a script: a progress event."""
    values = {"loss": 0.5, "psnr": 20.0, "splats": 1000, "steps_per_s": 10.0, "eta_s": 9.0}
    values |= {"iterations": 100, "elapsed_s": 1.0, "phase": "growing", "step": number}
    return {"say": {"event": "progress"} | values | changes}


def finish(path: str = "$out/point_cloud.ply") -> dict:
    """A step of a script: the last event of a successful run."""
    return {"say": done(100, "finished", path) | {"splats": 1234}}


def fake_python(folder: Path, script: list[dict]) -> Path:
    """A program that plays `script` in place of a Python with gscore."""
    path, program = folder / "script.json", folder / "fake-python"
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(script))
    program.write_text(
        f"#!/bin/sh\nFAKE_TRAINER='{path}' exec '{sys.executable}' '{__file__}' \"$@\"\n"
    )
    program.chmod(0o755)
    return program


def say(text: str) -> None:
    """Print a line; like the real trainer, ignore that the reader may be gone."""
    try:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


def progress(step: int, *, phase: str = "growing", iterations: int = 100) -> dict:
    """A progress event whose loss falls with the step."""
    return {
        "event": "progress",
        "step": step,
        "iterations": iterations,
        "loss": 1.0 / (1 + step),
        "psnr": 20.0 + step / 10,
        "splats": 1000 + step,
        "steps_per_s": 50.0,
        "eta_s": (iterations - step) / 50.0,
        "elapsed_s": step / 50.0,
        "phase": phase,
    }


def done(step: int, reason: str, path: str) -> dict:
    """The last event."""
    return {
        "event": "done",
        "step": step,
        "reason": reason,
        "splats": 1000 + step,
        "train_seconds": 2.0,
        "path": path,
        "metrics": {"psnr": 25.0, "split": "test"},
    }


class Player:
    """Plays the steps of a script."""

    def __init__(self, output: Path) -> None:
        self.output = output
        self.orders: queue.Queue[str | None] = queue.Queue()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        for line in sys.stdin:
            self.orders.put(line.strip())
        self.orders.put(None)

    def play(self, steps: list[dict], index: int = 0) -> None:
        """All steps in order."""
        for step in steps:
            ((verb, value),) = step.items()
            getattr(self, f"do_{verb}")(value, index)

    def do_say(self, event: dict, index: int) -> None:
        say(json.dumps(event).replace('"$i"', str(index)).replace("$out", str(self.output)))

    def do_raw(self, text: str, index: int) -> None:
        sys.stdout.buffer.write(text.encode("latin-1"))
        sys.stdout.flush()

    def do_stderr(self, text: str, index: int) -> None:
        sys.stderr.write(text + "\n")
        sys.stderr.flush()

    def do_huge(self, count: int, index: int) -> None:
        say("x" * count)

    def do_sleep(self, seconds: float, index: int) -> None:
        time.sleep(seconds)

    def do_write(self, value: list[str], index: int) -> None:
        path = Path(value[0].replace("$out", str(self.output)))
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(value[1])

    def do_loop(self, value: list, index: int) -> None:
        for i in range(value[0]):
            self.play(value[1], i)

    def do_await(self, command: str, index: int) -> None:
        line = self.orders.get(timeout=600)
        while line == "snapshot" != command:  # which Blender asks for on its own after a while
            line = self.orders.get(timeout=600)
        say(json.dumps({"event": "warning", "message": f"got {line}", "code": ""}))
        if line != command:
            sys.exit(9)

    def do_follow(self, seconds: float, index: int) -> None:
        """Steps of 20 ms until `seconds` are over, or a stop, or the end of stdin."""
        step, paused, until = 0, False, time.monotonic() + seconds
        while time.monotonic() < until:
            order = "" if self.orders.empty() else self.orders.get()
            if order == "snapshot":
                path = self.output / "snapshots" / f"step_{step:06d}.ply"
                say(
                    json.dumps(
                        {"event": "snapshot", "step": step, "path": str(path), "splats": 1000}
                    )
                )
            paused = (paused or order == "pause") and order != "resume"
            if order in ("stop", None):
                return self._stopped(step, "stopped" if order else "input ended")
            if order == "pause":
                say(json.dumps(progress(step, phase="paused")))
            if not paused:
                step += 1
                say(json.dumps(progress(step)))
            time.sleep(0.02)
        return None

    def _stopped(self, step: int, reason: str) -> None:
        checkpoint = self.output / "checkpoints" / f"step_{step:08d}.safetensors"
        self.do_write([str(checkpoint), "state"], 0)
        say(json.dumps({"event": "saved", "step": step, "path": str(checkpoint)}))
        say(json.dumps(done(step, reason, str(self.output / "point_cloud.ply"))))
        sys.exit(0)

    def do_exit(self, code: int, index: int) -> None:
        sys.exit(code)

    def do_signal(self, number: int, index: int) -> None:
        os.kill(os.getpid(), number)
        time.sleep(30)


def main() -> None:
    """Play the script named by the environment variable FAKE_TRAINER."""
    script = Path(os.environ["FAKE_TRAINER"])
    script.with_suffix(".args").write_text(json.dumps(sys.argv[1:]))
    named = sys.argv.index("-o") + 1 if "-o" in sys.argv else -1  # other verbs write elsewhere
    output = Path(sys.argv[named])
    Player(output).play(json.loads(script.read_text()))


if __name__ == "__main__":
    main()
