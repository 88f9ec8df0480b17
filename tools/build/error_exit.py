"""Error exit of build scripts: one sentence instead of a traceback."""

import functools
import subprocess
import sys
from collections.abc import Callable

import bpy_venvs


def exit_with_message(work: Callable[[], None]) -> Callable[[], int]:
    """Decorator for `main`: returns 0, or prints the error and returns 1."""

    @functools.wraps(work)
    def main() -> int:
        try:
            work()
        except (RuntimeError, bpy_venvs.NoPythonError) as error:
            print(error, file=sys.stderr)
            return 1
        except subprocess.CalledProcessError as error:
            print(f"{error.cmd[0]} failed; see its output above.", file=sys.stderr)
            return 1
        return 0

    return main
