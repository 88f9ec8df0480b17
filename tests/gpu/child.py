"""A child in place of the self-test, which does what GSCORE_TEST_CHILD names."""

import json
import os
import signal
import sys
import time

from gscore.raster.gpu.self_test import end_in_time


def _write(message: dict[str, object]) -> None:
    sys.stdout.write(f"a line of a driver\n{json.dumps(message)}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    how = os.environ["GSCORE_TEST_CHILD"]
    if len(sys.argv) > 3:
        end_in_time(float(sys.argv[3]))
    _write({"doing": "drawing"})
    if how == "passes":
        _write({"passed": True, "problems": [], "figures": {"seconds": 1.5}})
    elif how == "fails":
        _write({"passed": False, "problems": ["rgb differs"], "figures": {}})
    elif how == "lacks memory":
        failed = {"passed": False, "problems": ["no memory"], "figures": {}, "lasting": False}
        _write(failed)
    elif how == "crashes":
        os.kill(os.getpid(), signal.SIGSEGV)
    elif how == "is killed":
        os.kill(os.getpid(), signal.SIGKILL)
    elif how == "raises":
        raise ValueError("no")
    elif how == "hangs":
        time.sleep(3600)
