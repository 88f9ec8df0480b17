"""Parts of a model in several files: an index that lists them, replaced under new names.

Parts get unused names and are written before their index, so that the index on the disk always
finds its own parts, even if the disk is full or the program is killed in between. It has a CRC-32
of each part, to detect exchanged parts.
"""

import contextlib
import re
import zlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from ..errors import FormatError
from ..io.files import atomic_write
from ..json_text import parse_json
from ..quoting import quoted

Content = bytes | Callable[[BinaryIO], None]
NamesIn = Callable[[dict[str, Any]], Iterable[Any]]
"""Returns the part names in the JSON of an index; raises LookupError or TypeError without any."""
_BLOCK = 1 << 22


def write_parts(
    index: Path,
    parts: Mapping[str, Content],
    text_of: Callable[[dict[str, str], dict[str, int]], bytes],
    names_in: NamesIn,
) -> None:
    """Write the parts under unused names, then the index; then remove the parts of the old index,
    if gscore wrote it.

    Args:
        index: The file that lists the parts, which are written next to it.
        parts: Contents of the parts by preferred name.
        text_of: Returns the index, from the names and CRC-32s of the parts by key of `parts`.
        names_in: Finds the parts in an index.

    Raises:
        GsError: a file cannot be written; the old model is untouched.
    """
    old, is_ours = _named(index, names_in)
    names = _free_names(index.parent, parts)
    written: list[Path] = []
    try:
        for name, content in parts.items():
            atomic_write(index.with_name(names[name]), content)
            written.append(index.with_name(names[name]))
        checks = {
            name: zlib.crc32(content) if isinstance(content, bytes) else _crc32(path)
            for (name, content), path in zip(parts.items(), written, strict=True)
        }
        atomic_write(index, text_of(names, checks))
    except Exception:  # not an interrupt, which may come after the index was renamed
        _remove(written)
        raise
    if is_ours:
        _remove(path for path in old if path not in written and _is_named_like(path, parts))


def _is_named_like(path: Path, parts: Iterable[str]) -> bool:
    """True if a file has the name of a part or one of its numbered alternatives, because an index
    may list unrelated files, or those of the model it was copied from."""
    names = ((Path(name).stem, Path(name).suffix) for name in parts)
    return any(
        re.fullmatch(rf"{re.escape(stem)}(\.\d+)?{re.escape(suffix)}", path.name)
        for stem, suffix in names
    )


def parts_of(index: Path, names_in: NamesIn) -> tuple[Path, ...]:
    """Part files of an index; empty if it is missing or damaged."""
    return _named(index, names_in)[0]


def check_part(index: Path, name: str, content: bytes | memoryview, check: Any) -> None:
    """Raise FormatError if a part differs from the CRC-32 in its index, if it has one."""
    if type(check) is int and zlib.crc32(content) != check:
        raise FormatError(
            f"{index}: {quoted(name)} next to it is not the part that was written with it: it was "
            f"exchanged or damaged. Copy all parts again, or export the model again."
        )


def _named(index: Path, names_in: NamesIn) -> tuple[tuple[Path, ...], bool]:
    """Parts of an index, and whether gscore wrote it."""
    try:
        content = parse_json(index.read_bytes())
        names = [name for name in names_in(content) if isinstance(name, str)]
        is_ours = str(content["asset"]["generator"]).startswith("gscore ")
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return (), False
    plain = (name for name in names if name not in ("", ".", "..") and Path(name).name == name)
    return tuple(index.with_name(name) for name in plain if "\\" not in name), is_ours


def _free_names(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """Unused names in the folder: these, or all with the same number before the ending."""
    free, number = {name: name for name in names}, 1
    while any((folder / name).exists() for name in free.values()):
        number += 1
        free = {name: f"{Path(name).stem}.{number}{Path(name).suffix}" for name in free}
    return free


def _crc32(path: Path) -> int:
    check = 0
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            check = zlib.crc32(block, check)
    return check


def _remove(files: Iterable[Path]) -> None:
    for file in files:
        with contextlib.suppress(OSError):
            file.unlink()
