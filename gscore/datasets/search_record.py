"""Search record: photos without a camera, listed by the SfM of a capture."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeGuard

from ..errors import GsError
from ..io.files import read_bytes
from ..io.runs import SEARCH_RECORD
from ..json_text import parse_json
from ..text_format import count_words
from .capture import listing


def unplaced_photos_text(others: Sequence[Sequence[str]], alone: Sequence[str]) -> list[str]:
    """Messages about photos without a camera, with the remedy.

    Args:
        others: Names of the photos of each model but the largest.
        alone: Names of the photos in no model.
    """
    messages = [
        f"{count_words(len(other), 'photo forms', 'photos form')} a separate model and "
        f"{'is' if len(other) == 1 else 'are'} left out: {listing(list(other))}. If it is the same "
        "scene, take photos between the two; if not, use separate folders."
        for other in others
    ]
    if alone:
        messages.append(
            f"{count_words(len(alone), 'photo matches', 'photos match')} no other: "
            f"{listing(list(alone))}. Take photos between these and the others, or remove them if "
            "they are blurred or show another scene."
        )
    return messages


def search_warnings(source: Path, views: int) -> list[str]:
    """Warning if gscore's SfM found cameras for only some of a capture's photos.

    Args:
        source: The capture.
        views: Number of views of its model; a record with another number is of another model.
    """
    try:
        record = parse_json(read_bytes(source / SEARCH_RECORD))
    except (GsError, ValueError):
        return []  # cameras from another program
    if not isinstance(record, dict) or record.get("registered") != views:
        return []
    others, alone, photos = record.get("others"), record.get("alone"), record.get("photos")
    if not (isinstance(others, list) and all(map(_are_names, others)) and _are_names(alone)):
        return []
    if not (isinstance(photos, int) and (messages := unplaced_photos_text(others, alone))):
        return []
    return [" ".join([f"{views} of {count_words(photos, 'photo')} have a camera.", *messages])]


def _are_names(value: Any) -> TypeGuard[list[str]]:
    return isinstance(value, list) and all(isinstance(name, str) for name in value)
