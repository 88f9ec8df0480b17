"""Imports that leave signals alone; oracle: an earlier handler of Python's."""

import subprocess
import sys

import pytest

pytest.importorskip("pycolmap")

SCRIPT = """
import os, signal, sys, threading, time
signal.signal(signal.SIGTERM, lambda *_: print("asked to end"))
from gscore.extras import need
def load():
    need("pycolmap", "This test")
if sys.argv[1] == "thread":
    thread = threading.Thread(target=load)
    thread.start()
    thread.join()
else:
    load()
os.kill(os.getpid(), signal.SIGTERM)
time.sleep(0.1)
print("alive")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="SIGTERM cannot be sent there")
@pytest.mark.parametrize("where", ["thread", "main"])
def test_pycolmap_takes_no_signals(where: str) -> None:
    """Oracle: a process with `import pycolmap` alone, which dies with a stack trace."""
    done = subprocess.run([sys.executable, "-c", SCRIPT, where], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "asked to end\nalive\n", "")
