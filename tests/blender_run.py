"""Runs pytest inside a Blender program.

`blender -b --factory-startup -P tests/blender_run.py -- [--packages FOLDER] [pytest's arguments]`,
without arguments the add-on's tests. FOLDER holds what Blender's Python lacks: pytest and plyfile.
Set BLENDER_USER_RESOURCES to an empty folder to keep your own profile out of it.
"""

import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def main() -> int:
    """Run the tests that the arguments after `--` name; pytest's exit status."""
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
    if arguments[:1] == ["--packages"]:
        sys.path.append(arguments[1])
        os.environ["PYTHONPATH"] = arguments[1]  # for the Pythons that tests start
        arguments = arguments[2:]
    sys.path.insert(0, str(ROOT))
    os.chdir(ROOT)
    import pytest

    return int(pytest.main(arguments or ["-q", "tests/addon"]))


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    # Blender exits with 0 after a script whatever its result, unless the process ends here.
    os._exit(status)
