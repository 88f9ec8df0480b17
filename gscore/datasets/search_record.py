"""Search record: photos without a camera, as listed by the camera search of a capture."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeGuard

from ..errors import GsError
from ..io.files import read_bytes
from ..io.runs import SEARCH_RECORD
from ..json_text import parse_json
from ..text_format import count_words
from .capture import listing


def left_out_text(others: Sequence[Sequence[str]], alone: Sequence[str]) -> list[str]:
    """Sentences on photos without a camera, and what to do about them.

    Args:
        others: Names of the photos of each model but the largest.
        alone: Names of those in no model.
    """
    told = [
        f"{count_words(len(other), 'photo makes', 'photos make')} a model of their own and "
        f"{'is' if len(other) == 1 else 'are'} left out: {listing(list(other))}. If it is the same "
        "scene, take photos between the two; if not, use folders of their own."
        for other in others
    ]
    if alone:
        told.append(
            f"{count_words(len(alone), 'photo stands', 'photos stand')} alone: "
            f"{listing(list(alone))}. Take photos between these and the others, or remove them if "
            "they are blurred or show something else."
        )
    return told


def search_warnings(source: Path, views: int) -> list[str]:
    """A sentence where gscore found the cameras of a capture and not all photos have one.

    Args:
        source: The capture.
        views: Of its model; a record of another number was not made with this model.
    """
    try:
        found = parse_json(read_bytes(source / SEARCH_RECORD))
    except (GsError, ValueError):
        return []  # somebody else found them
    if not isinstance(found, dict) or found.get("registered") != views:
        return []
    others, alone, photos = found.get("others"), found.get("alone"), found.get("photos")
    if not (isinstance(others, list) and all(map(_are_names, others)) and _are_names(alone)):
        return []
    if not (isinstance(photos, int) and (told := left_out_text(others, alone))):
        return []
    return [" ".join([f"{views} of {count_words(photos, 'photo')} have a camera.", *told])]


def _are_names(value: Any) -> TypeGuard[list[str]]:
    return isinstance(value, list) and all(isinstance(name, str) for name in value)
