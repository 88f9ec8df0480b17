"""Python's copy of csrc/shared/constants.h: writes gscore/shared_constants.py.

`python tools/build/shared_constants.py` writes it, `--check` fails if it is not up to date. The
installed package and the add-on have no csrc/, so the copy is part of the repository.
"""

import re
import sys
from pathlib import Path

from error_exit import exit_with_message

ROOT = Path(__file__).parents[2]
HEADER = ROOT / "csrc" / "shared" / "constants.h"
MODULE = ROOT / "gscore" / "shared_constants.py"
_HEAD = '''"""Constants of the splat pipeline; csrc/shared/constants.h has their reasons.

Written by tools/build/shared_constants.py; do not edit.
"""

'''
_DEFINE = re.compile(r"^#define GS_(\w+) (.+)$", re.MULTILINE)
_NUMBER = re.compile(r"(?<![\w.])(?:(0x[0-9A-F]+)u|(\d[\d.]*(?:e[+-]?\d+)?)f?)")


def constants(text: str) -> dict[str, str]:
    """Python expressions of the constants of a header, by name without GS_."""
    found = {}
    for name, value in _DEFINE.findall(text.replace("\\\n", " ")):
        numbers = [_python(part) for part in value.strip().split(",")]
        found[name] = numbers[0] if len(numbers) == 1 else f"({', '.join(numbers)})"
    return found


def _python(expression: str) -> str:
    """A number, product or quotient of C as Python writes it, in double precision; hexadecimal
    numbers stay so."""
    plain = expression.strip().removeprefix("(").removesuffix(")")
    return _NUMBER.sub(lambda found: found[1] or repr(_value(found[2])), plain)


def _value(text: str) -> int | float:
    return int(text) if text.isdigit() else float(text)


def module(text: str) -> str:
    """The Python module for a header."""
    lines = []
    for name, value in constants(text).items():
        line = f"{name} = {value}"
        if len(line) > 100:
            line = f"{name} = (\n    " + value[1:-1].replace(", ", ",\n    ") + ",\n)"
        lines.append(line)
    return _HEAD + "\n".join(lines) + "\n"


@exit_with_message
def main() -> None:
    """Write the module, or compare it."""
    wanted = module(HEADER.read_text(encoding="utf-8"))
    if sys.argv[1:] != ["--check"]:
        MODULE.write_text(wanted, encoding="utf-8")
    elif not MODULE.is_file() or MODULE.read_text(encoding="utf-8") != wanted:
        raise RuntimeError(
            "gscore/shared_constants.py does not follow csrc/shared/constants.h; "
            "run tools/build/shared_constants.py"
        )


if __name__ == "__main__":
    sys.exit(main())
