"""Errors of the builders: one sentence instead of a traceback."""

import functools
import subprocess
import sys
from collections.abc import Callable

import bpy_venvs


def told(work: Callable[[], None]) -> Callable[[], int]:
    """`work` as a program's `main`: it returns 0, or 1 after the sentence of what failed."""

    @functools.wraps(work)
    def main() -> int:
        try:
            work()
        except (RuntimeError, bpy_venvs.NoPythonError) as error:
            print(error, file=sys.stderr)
            return 1
        except subprocess.CalledProcessError as error:
            print(f"{error.cmd[0]} failed; what it says stands above.", file=sys.stderr)
            return 1
        return 0

    return main
