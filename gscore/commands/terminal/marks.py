"""File marks: detects files written by gscore, by a mark in each format."""

import contextlib
import re
import zipfile
from pathlib import Path
from typing import Any

from ...errors import GsError
from ...formats.sog import META
from ...io.lod_index import KIND
from ...io.ply.splats import header_comments
from ...json_text import parse_json

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
    starts = (_PAGE.match(head), _FIGURE.match(head), head.startswith(f"{KIND}\n".encode()))
    return any(starts)


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
