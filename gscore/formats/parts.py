"""Parts of a model in several files: an index that lists them, replaced under new names.

Parts get unused names and are written before their index, so that the index on the disk always
finds its own parts, even if the disk is full or the program is killed in between. It has a CRC-32
of each part, to detect exchanged parts. A record of the parts, which stays if the program is
killed, lets the next write of the same index remove those that no index names.
"""

import contextlib
import json
import os
import re
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from ..errors import FormatError
from ..io.files import atomic_write, write_record
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
    optional: Iterable[str] = (),
) -> None:
    """Write the parts under unused names, then the index; then remove the parts of the old index,
    if gscore wrote it.

    Args:
        index: The file that lists the parts, which are written next to it.
        parts: Contents of the parts by preferred name.
        text_of: Returns the index, from the names and CRC-32s of the parts by key of `parts`.
        names_in: Finds the parts in an index.
        optional: Preferred names of parts that only some models have.

    Raises:
        GsError: a file cannot be written; the old model is untouched.
    """
    usual = {*parts, *optional}

    def tidy(notes: bytes) -> None:
        noted = (path for path in _noted(index, notes) if _is_named_like(path, usual))
        _remove_unnamed(index, noted, names_in)

    with write_record(index.with_name(f"{index.name}.parts"), tidy) as record:
        old, is_ours = _named(index, names_in)
        old = [path for path in old if is_ours and _is_named_like(path, usual)]
        for path in old:
            with contextlib.suppress(OSError):  # it is missing
                _note(record, path, path.stat())
        names = _free_names(index.parent, parts)
        written: list[Path] = []
        try:
            for name, content in parts.items():
                path = index.with_name(names[name])
                atomic_write(path, _noting(record, path, content))
                written.append(path)
            checks = {
                name: zlib.crc32(content) if isinstance(content, bytes) else _crc32(path)
                for (name, content), path in zip(parts.items(), written, strict=True)
            }
            atomic_write(index, text_of(names, checks))
        except Exception:
            _remove(written)
            raise
        except BaseException:  # an interrupt, which may come after the index was renamed
            record.seek(0)
            tidy(record.read())
            raise
        _remove(path for path in old if path not in written)


def _noting(record: BinaryIO, path: Path, content: Content) -> Callable[[BinaryIO], None]:
    """Writer of a part that notes it before it gets its name."""

    def write(file: BinaryIO) -> None:
        if callable(content):
            content(file)
        else:
            file.write(content)
        file.flush()
        _note(record, path, os.fstat(file.fileno()))

    return write


def _note(record: BinaryIO, path: Path, stat: os.stat_result) -> None:
    """Note that gscore wrote a file; its size and time tell it from later ones of that name."""
    record.write(json.dumps([path.name, stat.st_size, stat.st_mtime_ns]).encode() + b"\n")
    record.flush()


def _noted(index: Path, notes: bytes) -> Iterator[Path]:
    """Files next to an index that are as they were when they were noted."""
    for line in notes.splitlines():
        with contextlib.suppress(OSError, ValueError, TypeError):
            name, size, modified = parse_json(line)
            for path in _next_to(index, [name]):
                stat = path.lstat()
                if (stat.st_size, stat.st_mtime_ns) == (size, modified):
                    yield path


def _remove_unnamed(index: Path, files: Iterable[Path], names_in: NamesIn) -> None:
    """Remove files that neither the index nor a renamed or copied one next to it names; none if
    the index is damaged."""
    if index.exists() and not parts_of(index, names_in):
        return
    indexes = [index, *index.parent.glob(f"*{index.suffix}")] if (files := [*files]) else []
    named = {path for one in indexes for path in parts_of(one, names_in)}
    _remove(path for path in files if path not in named)


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
    return tuple(_next_to(index, names)), is_ours


def _next_to(index: Path, names: Iterable[str]) -> Iterator[Path]:
    """Paths of plain names in the folder of an index."""
    plain = (name for name in names if name not in ("", ".", "..") and Path(name).name == name)
    return (index.with_name(name) for name in plain if "\\" not in name)


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
