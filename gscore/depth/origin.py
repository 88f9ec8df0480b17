"""Origin of stereo depth maps: the photos that they were made from, stored with the maps."""

import json
from collections.abc import Collection, Sequence
from pathlib import Path

from .._version import __version__
from ..errors import FormatError
from ..io.files import atomic_write
from ..json_text import parse_json
from ..quoting import brief
from ..text_format import count_text

STEREO_RECORD = "stereo.json"
"""Record next to depth maps made by stereo."""


def write_record(folder: Path, views: Sequence[str], maps: Sequence[str]) -> None:
    """Write the record: the photos used, and the views that got a map."""
    record = {"gscore": __version__, "method": "stereo", "photos": [*views], "maps": [*maps]}
    text = json.dumps(record, indent=2, ensure_ascii=False) + "\n"
    atomic_write(folder / STEREO_RECORD, text.encode("utf-8"))


def read_record(folder: Path) -> dict[str, list[str]] | None:
    """`photos` and `maps` of the record in a folder of maps; None: there is none.

    Raises:
        FormatError: it is damaged.
    """
    path = folder / STEREO_RECORD
    if not path.is_file():
        return None
    try:
        content = parse_json(path.read_bytes())
        found = {key: [str(name) for name in content[key]] for key in ("photos", "maps")}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FormatError(
            f"{path} is damaged ({brief(error)}). Make the maps again: gscore depth SOURCE "
            "--method stereo --overwrite"
        ) from error
    return found


def held_out_maps_warning(folder: Path, held_out: Collection[str]) -> tuple[str, ...]:
    """Warning if depth maps were made with photos that a run holds out; else empty."""
    record = read_record(folder)
    among = [] if record is None else sorted(set(record["photos"]) & set(held_out))
    if not among:
        return ()
    return (
        f"The depth maps in {folder} were made with "
        f"{count_text(len(among), 'held-out photo', 'held-out photos')}, for example "
        f"{brief(among[0])}, so the metrics of held-out views are too good. Make the maps again "
        "without them: gscore depth SOURCE --method stereo --hold-out 8",
    )
