"""Quoting of untrusted text in messages: short and printable."""

import reprlib
import shlex
import shutil
import sys
from pathlib import Path
from typing import Any

_LONGEST = 200


def brief(text: str | Path | Exception) -> str:
    """A path, a name or another error's words: shortened, and with what no output can print
    replaced."""
    text = str(text)
    cut = text[: _LONGEST + 1].encode("utf-8", "replace").decode("utf-8").replace("\0", "?")
    return cut if len(cut) <= _LONGEST else f"{cut[: _LONGEST - 3]}..."


def as_typed(*words: str | Path) -> str:
    """A command of gscore as a shell takes it: with quotes where they are needed, and the program
    as it was called itself where it does not lie on PATH."""
    called = Path(sys.argv[0])
    away = called.stem == "gscore" and shutil.which("gscore") is None
    return shlex.join([str(called) if away else "gscore", *map(str, words)])


def quoted(value: Any) -> str:
    """A value as Python writes it: whole where it is short, the ends of long texts, the beginning
    of long lists; millions of numbers are not even looked at."""
    return brief(_REPR.repr(value))


_REPR = reprlib.Repr()
_REPR.maxlist = _REPR.maxtuple = _REPR.maxset = _REPR.maxdict = 16
_REPR.maxstring = _REPR.maxother = _REPR.maxlong = _LONGEST
