"""Run as a rank: gscore with rank 0 killed the first time, after all work is done."""

import os
import signal
import sys

from gscore.commands import main

if __name__ == "__main__":
    code = main(sys.argv[1:])
    if os.environ["RANK"] == "0" and os.environ["TORCHELASTIC_RESTART_COUNT"] == "0":
        os.kill(os.getpid(), signal.SIGKILL)
    sys.exit(code)
