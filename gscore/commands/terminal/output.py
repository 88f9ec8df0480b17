"""Output of a verb: JSON on stdout; paths checked before the work, by gscore's marks in files."""

import contextlib
import os
import re
import sys
import zipfile
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

from ...errors import ConfigError, GsError
from ...events import strict_json
from ...formats.sog import META
from ...io.files import reason
from ...io.lod_index import KIND
from ...io.ply.splats import header_comments
from ...json_text import parse_json
from ...quoting import brief, first_few
from .status import wrapped

_NAMELESS = (".spz", ".splat", ".usd", ".usda", ".usdc", ".usdz", ".bin")
"""Endings of formats without comments."""


PAGE_HINT = "Open it in a browser, or share it: the page is self-contained."
"""Last line of verbs that write a page."""


def print_json(content: Any) -> None:
    """One line of strict JSON on stdout."""
    print(strict_json(content), flush=True)


def print_result(facts: Any, lines: Sequence[str], *, json: bool, quiet: bool = False) -> None:
    """The result of a verb on stdout: `facts` as JSON, else the lines of text unless `quiet`."""
    if json:
        print_json(facts)
    elif not quiet:
        print(wrapped("\n".join(lines), sys.stdout))


def check_replaced(paths: Iterable[Path], *, overwrite: bool) -> None:
    """Raise unless files may be written at these paths, replacing existing ones.

    Args:
        paths: Output files.
        overwrite: Replace files without gscore's mark too. Files with the mark are always
            replaced; SPZ, .splat, USD and .gltf buffers cannot have one.

    Raises:
        ConfigError: a path is not a regular file, or is a file without the mark.
    """
    existing = [path for path in paths if path.exists()]
    for path in existing:
        if not path.is_file():
            what = "a folder" if path.is_dir() else "not a regular file"
            raise ConfigError(f"{brief(path)} is {what}, so no file can be written there.")
    foreign = [] if overwrite else [path for path in existing if not is_ours(path)]
    if foreign:
        raise ConfigError(
            f"{first_few([str(path) for path in foreign])} exists already, without a mark of "
            f"gscore{_never(foreign)}, so it is kept. Choose another output, or give `--overwrite`."
        )


def check_page(path: Path, *, overwrite: bool) -> None:
    """Raise ConfigError unless a page of a verb may be written at a path, as by `check_folder` and
    `check_replaced`; never over the report of a run."""
    if path.name == "report.html":
        raise ConfigError(f"{brief(path)} is the name of a run's report; give another one.")
    check_folder(path.parent)
    check_replaced([path], overwrite=overwrite)


def _never(paths: list[Path]) -> str:
    """Note on formats whose files cannot have a mark."""
    if any(path.suffix.lower() in _NAMELESS for path in paths):
        return " (SPZ, .splat, USD and .bin files never have one)"
    return ""


def check_folder(folder: Path) -> None:
    """Raise unless files can be written into `folder`, which may not exist yet.

    Raises:
        ConfigError: A part of the path is a file, or the nearest existing folder is read-only.
    """
    try:
        folder.stat()
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        pass
    except (OSError, ValueError) as error:
        raise ConfigError(f"Cannot use {brief(folder)}: {reason(error)}") from error
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        raise ConfigError(f"{existing} is a file; a folder is needed. Choose another output.")
    if not os.access(existing, os.W_OK | os.X_OK):
        why = "the disk is read-only" if _is_read_only(existing) else "permission denied"
        raise ConfigError(f"Cannot write into {existing}: {why}; choose another output.")


def _is_read_only(folder: Path) -> bool:
    """Whether the file system of a folder is read-only; False if unknown."""
    return hasattr(os, "statvfs") and bool(os.statvfs(folder).f_flag & os.ST_RDONLY)


def other_files(folder: Path, known: Collection[str]) -> str:
    """The first few names in a folder for a message, without `known` names and hidden files; empty
    if there are none."""
    names: list[str] = []
    with contextlib.suppress(OSError, ValueError):  # writing there reports the error
        names = sorted(p.name for p in folder.iterdir() if not p.name.startswith("."))
    return first_few([name for name in names if name not in known])


_HEAD = 1 << 16
"""Leading bytes that contain all marks of pictures and pages."""
_MOST_JSON = 1 << 28
_MOST_META = 1 << 22
_MOST_FILM = 1 << 26
"""Leading bytes of an MP4 that contain its index, which is written first."""
_COMMENTS = ("gscore convert", "merged by gscore", "made by gscore")
"""Prefixes of PLY comments, in lower case."""
_PAGE = re.compile(
    rb"<!doctype html>\n(?:<!-- written by gscore -->\n|"
    # Reports of versions without the line above.
    rb'<html lang="en">\n<head>\n<meta charset="utf-8">\n<meta name="viewport" '
    rb'content="width=device-width, initial-scale=1">\n'
    rb"<title>[^<]*: (?:gscore report|two runs compared by gscore)</title>\n)"
)
MARKDOWN_MARK = "<!-- written by gscore -->\n"
"""First line of a Markdown file."""
_FIGURE = re.compile(rb"<svg [^>]*><metadata>gscore</metadata>")
_SOFTWARE = b"\0\0\0\x0ftEXtSoftware\0gscore"
"""A PNG chunk of 15 bytes."""
_FILM = re.compile(rb"\xa9cmt.{4}data.{8}Rendered by gscore", re.DOTALL)
"""The comment of an MP4: a QuickTime metadata item with its data."""


def is_ours(path: Path) -> bool:
    """Whether a file may be replaced: it is empty, or has gscore's mark."""
    with contextlib.suppress(OSError, ValueError, GsError, zipfile.BadZipFile, RecursionError):
        with path.open("rb") as file:
            head = file.read(_HEAD)
        return not head or _is_marked(path, head)
    return False


def _is_marked(path: Path, head: bytes) -> bool:
    if head.startswith(b"\x89PNG"):
        return _SOFTWARE in head[: head.find(b"IDAT")]
    if head.startswith(b"ply"):
        return any(line.lower().startswith(_COMMENTS) for line in header_comments(path))
    if head.startswith(b"PK"):
        with zipfile.ZipFile(path) as archive, archive.open(META) as file:
            return _names_us(parse_json(file.read(_MOST_META)))
    if head.startswith(b"glTF"):  # header, then a JSON chunk preceded by its size
        size = int.from_bytes(head[12:16], "little")
        return _names_us(parse_json(_begin(path, 20 + size)[20:]))
    if head[4:8] == b"ftyp":
        return _FILM.search(_begin(path, _MOST_FILM)) is not None
    if head.lstrip().startswith(b"{"):
        return _names_us(parse_json(_begin(path, _MOST_JSON)))
    starts = (f"{KIND}\n".encode(), MARKDOWN_MARK.encode(), b"# made by gscore\n")
    return any((_PAGE.match(head), _FIGURE.match(head), head.startswith(starts)))


def _names_us(content: Any) -> bool:
    """Whether a JSON object states the version of gscore, or gscore as generator (glTF, SOG)."""
    if not isinstance(content, dict):
        return False
    asset = content.get("asset")
    maker = asset.get("generator") if isinstance(asset, dict) else None
    return isinstance(content.get("gscore"), str) or str(maker).startswith("gscore ")


def _begin(path: Path, size: int) -> bytes:
    with path.open("rb") as file:
        return file.read(size)
