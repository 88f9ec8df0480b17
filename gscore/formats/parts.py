"""Parts of a model in several files: an index that names them, replaced under new names.

An index is renamed into its place after its parts, whose names no file had: at every moment the
index that is there finds its own parts, also where a disk is full or the program is killed between
two of them. It holds a CRC-32 of each part, so that parts that were exchanged are noticed.
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
"""The parts that the JSON of an index names; raises LookupError or TypeError where there are none.
"""
_BLOCK = 1 << 22


def write_parts(
    index: Path,
    parts: Mapping[str, Content],
    text_of: Callable[[dict[str, str], dict[str, int]], bytes],
    names_in: NamesIn,
) -> None:
    """Write the parts under names that are free, then the index; then remove the parts of the old
    index, if gscore wrote it.

    Args:
        index: The file that names the others, which lie beside it.
        parts: What they hold, by the names that they have where these are free.
        text_of: The index, for the name and the CRC-32 of each part, by the keys of `parts`.
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
    """Whether a file has the name of a part, or one of the free names that stand in for it: an
    index may name files of others, or those of the model that it was copied from."""
    names = ((Path(name).stem, Path(name).suffix) for name in parts)
    return any(
        re.fullmatch(rf"{re.escape(stem)}(\.\d+)?{re.escape(suffix)}", path.name)
        for stem, suffix in names
    )


def parts_of(index: Path, names_in: NamesIn) -> tuple[Path, ...]:
    """The files beside an index that it names; none where it is missing or damaged."""
    return _named(index, names_in)[0]


def check_part(index: Path, name: str, content: bytes | memoryview, check: Any) -> None:
    """Raise FormatError unless a part has the CRC-32 that its index states, if it states one."""
    if type(check) is int and zlib.crc32(content) != check:
        raise FormatError(
            f"{index}: {quoted(name)} beside it is not the part that was written with it: it was "
            f"exchanged or damaged. Copy all parts again, or export the model again."
        )


def _named(index: Path, names_in: NamesIn) -> tuple[tuple[Path, ...], bool]:
    """The parts that an index names, and whether gscore wrote it."""
    try:
        content = parse_json(index.read_bytes())
        names = [name for name in names_in(content) if isinstance(name, str)]
        is_ours = str(content["asset"]["generator"]).startswith("gscore ")
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return (), False
    plain = (name for name in names if name not in ("", ".", "..") and Path(name).name == name)
    return tuple(index.with_name(name) for name in plain if "\\" not in name), is_ours


def _free_names(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """Names that no file of the folder has: these, or all with one number before the ending."""
    found, number = {name: name for name in names}, 1
    while any((folder / name).exists() for name in found.values()):
        number += 1
        found = {name: f"{Path(name).stem}.{number}{Path(name).suffix}" for name in found}
    return found


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
