"""Quoting of untrusted text in messages, short and printable, and names for misspelt ones."""

import difflib
import reprlib
import shlex
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

_LONGEST = 200


def brief(text: str | Path | Exception) -> str:
    """A path, name or error message, shortened, with unprintable characters replaced."""
    text = str(text)
    cut = text[: _LONGEST + 1].encode("utf-8", "replace").decode("utf-8").replace("\0", "?")
    return cut if len(cut) <= _LONGEST else f"{cut[: _LONGEST - 3]}..."


def first_few(names: Sequence[str], most: int = 5) -> str:
    """The first names, for a message, and the number of the others: a, b and 3 more."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(map(brief, names[:most])) + more


def nearest(word: str, known: Sequence[str]) -> str:
    """The known name most similar to `word`; empty if none is."""
    word = word.lower()
    longer = [name for name in known if len(word) > 2 and name.startswith(word)]
    if len(longer) == 1:
        return longer[0]
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.6)
    return (close or longer or [""])[0]


def as_typed(*words: str | Path) -> str:
    """A gscore command for a shell: quoted where needed, with the path of the program if it is not
    on PATH."""
    called = Path(sys.argv[0])
    away = called.stem == "gscore" and shutil.which("gscore") is None
    return shlex.join([str(called) if away else "gscore", *map(str, words)])


def quoted(value: Any) -> str:
    """The `repr` of a value: shortened in the middle of long texts and at the end of long lists,
    whose other items are never formatted."""
    return brief(_REPR.repr(value))


_REPR = reprlib.Repr()
_REPR.maxlist = _REPR.maxtuple = _REPR.maxset = _REPR.maxdict = 16
_REPR.maxstring = _REPR.maxother = _REPR.maxlong = _LONGEST
