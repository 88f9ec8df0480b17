"""The end of the process waits for threads; oracle: the last output of a separate process."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
SCRIPT = """
import importlib.util, sys, threading, time
spec = importlib.util.spec_from_file_location("threads", sys.argv[1])
threads = importlib.util.module_from_spec(spec)
spec.loader.exec_module(threads)
threads.start_thread(lambda: (time.sleep(0.5), print("finished", flush=True)), "short")
ended = threading.Event()
asked = lambda: (ended.wait(60), print("asked to end", flush=True))
threads.start_thread(asked, "long", cancel=ended.set)
print("the end", flush=True)
sys.exit(3)
"""


def test_the_end_waits_and_asks() -> None:
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(ROOT / "addon" / "process" / "background_task.py")],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 3, done.stderr
    assert done.stdout.split("\n")[0] == "the end"
    assert set(done.stdout.split("\n")[1:3]) == {"finished", "asked to end"}
