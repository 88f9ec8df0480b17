"""What a message repeats of what it was given: short enough to read, and printable anywhere."""

import reprlib
from pathlib import Path
from typing import Any

_LONGEST = 200


def shown(text: str | Path | Exception) -> str:
    """A path, a name or another error's words: shortened, and with what no output can print
    replaced."""
    text = str(text)
    cut = text[: _LONGEST + 1].encode("utf-8", "replace").decode("utf-8").replace("\0", "?")
    return cut if len(cut) <= _LONGEST else f"{cut[: _LONGEST - 3]}..."


def quoted(value: Any) -> str:
    """A value as Python writes it: whole where it is short, the ends of long texts, the beginning
    of long lists; millions of numbers are not even looked at."""
    return shown(_REPR.repr(value))


_REPR = reprlib.Repr()
_REPR.maxlist = _REPR.maxtuple = _REPR.maxset = _REPR.maxdict = 16
_REPR.maxstring = _REPR.maxother = _REPR.maxlong = _LONGEST
