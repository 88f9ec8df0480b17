"""Frames of a sequence of captures, and their selection."""

import re
import string
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from ..config import DataConfig
from ..errors import ConfigError, DatasetError
from ..io.colmap.folder import has_model
from ..io.missing_path import missing_path
from ..quoting import first_few, quoted
from ..text_format import count_text
from .pku.case import find_video
from .programs import find_program
from .transforms_json import find_transforms

_PATTERNS = ("source", "images", "masks", "depths")
"""Options that may contain `{frame}`."""
_LISTED = 5
"""Most frame numbers in a message."""
_FRAMES = re.compile(r"\s*(\d{0,18})\s*(?:(:)\s*(\d{0,18})\s*(?::\s*(\d{1,18}))?)?\s*")
"""A number or a range; digits are limited because Python refuses to parse very long numbers."""
_NUMBERED = re.compile(r"\D*(\d+)")


@dataclass(frozen=True, kw_only=True)
class SequenceFrame:
    """One frame of a sequence, itself a capture."""

    number: int
    data: DataConfig

    @property
    def name(self) -> str:
        """Name of the folder of its results."""
        return f"frame_{self.number:06d}"


def find_frames(data: DataConfig) -> list[SequenceFrame]:
    """All frames that `data` describes, sorted by number.

    `data.source` is one of these:

    - a folder of PKU-DyMVHumans: a scenario or one of its layouts;
    - a folder of numbered captures, such as `000000/` or `frame_12/`, each with a COLMAP model or a
      transforms.json;
    - a path with `{frame}` or `{frame:06d}` in place of the number. `images`, `masks` and `depths`
      may contain it too, or instead: then all frames share one COLMAP model.

    Raises:
        DatasetError: there are no frames.
        ConfigError: a pattern has other text in braces.
    """
    if any("{" in str(getattr(data, name)) for name in _PATTERNS):
        return _from_pattern(data)
    video = find_video(data.source)
    if video is not None:
        return [
            SequenceFrame(
                number=number,
                # Except in `per_view`, the path already identifies the frame.
                data=replace(data, source=path, frame=number if path.name == "per_view" else None),
            )
            for number, path in video.frames().items()
        ]
    if not data.source.is_dir():
        raise DatasetError(
            missing_path(
                data.source,
                advice="Give a folder with a numbered folder for each frame, or a path with "
                "{frame:06d} in place of the number.",
            )
        )
    found: dict[int, Path] = {}
    for folder in sorted(data.source.iterdir()):
        match = _NUMBERED.fullmatch(folder.name)
        if match and folder.is_dir() and _is_capture(folder):
            _add(found, int(match[1]), folder)
    if not found:
        raise DatasetError(
            f"{data.source} contains no frames; expected a numbered folder for each, with photos "
            f"and a COLMAP model in it. If all frames share one model, give its folder, and "
            f"frames/{{frame:06d}} as `--images`."
        )
    return [
        SequenceFrame(number=n, data=replace(data, source=path))
        for n, path in sorted(found.items())
    ]


def choose_frames(frames: list[SequenceFrame], text: str) -> list[SequenceFrame]:
    """Select frames: `0,5,12`, `0:30` (inclusive), `0:30:5`, `10:`, `:20`, or joined by commas.

    Raises:
        ConfigError: `text` has another syntax.
        DatasetError: a number, or a whole range, does not exist.
    """
    numbers = {frame.number for frame in frames}
    chosen: set[int] = set()
    for part in text.split(","):
        match = _FRAMES.fullmatch(part)
        if match is None or not part.strip() or match[4] == "0":
            raise ConfigError(
                f"frames is {quoted(text)}; expected numbers such as 0,5,12 or ranges such as "
                f"0:30 or 0:30:5 (first, last, step)."
            )
        if match[2] is None:
            picked = numbers & {int(match[1])}
        else:
            first = int(match[1]) if match[1] else min(numbers)
            last = int(match[3]) if match[3] else max(numbers)
            inside = range(first, last + 1, int(match[4] or 1))
            picked = {number for number in numbers if number in inside}
        if not picked:
            known = sorted(numbers)
            raise DatasetError(
                f"There is no frame {part.strip()}: the sequence has "
                f"{count_text(len(known), 'frame')}, {first_few([str(n) for n in known], _LISTED)}"
                f"{f' up to {known[-1]}' if len(known) > _LISTED else ''}."
            )
        chosen |= picked
    return [frame for frame in frames if frame.number in chosen]


def of_frame(path: Path | None, number: int) -> Path | None:
    """Path with a frame's number in place of `{frame}` or `{frame:06d}`; other paths unchanged.

    Raises:
        ConfigError: it has other text in braces.
    """
    return path if path is None or "{" not in str(path) else Path(_fill(str(path), number))


def frame_pattern(folder: Path, name: str) -> Path:
    """Pattern for `of_frame`, for a file in a folder whose own name may contain braces.

    Args:
        folder: Kept literally.
        name: File name; may contain `{frame:06d}`, but no other braces.
    """
    if "{" not in f"{folder}{name}":
        return folder / name
    return Path(str(folder).replace("{", "{{").replace("}", "}}")) / name


def _is_capture(folder: Path) -> bool:
    places = (folder, folder / "sparse", folder / "sparse/0", folder / "colmap/sparse/0")
    stated = find_transforms(folder) or find_program(folder, below=False)
    return stated is not None or any(has_model(place) for place in places)


def _from_pattern(data: DataConfig) -> list[SequenceFrame]:
    source = str(data.source)
    if "{" in source:
        found = dict(_matches(Path(), source))
        shown = source
    else:
        shown = next(p for name in _PATTERNS if "{" in (p := str(getattr(data, name))))
        found = dict(_matches(data.source, shown))
    if not found:
        raise DatasetError(
            f"Nothing matches {quoted(shown)}{'' if '{' in source else f' in {source}'}; expected "
            f"a folder for each frame with its number in place of the braces."
        )
    frames = []
    for number in sorted(found):
        options = {name: getattr(data, name) for name in _PATTERNS}
        filled = {
            name: type(value)(_fill(str(value), number))
            for name, value in options.items()
            if "{" in str(value)
        }
        frames.append(SequenceFrame(number=number, data=replace(data, **filled)))
    return frames


def _matches(root: Path, pattern: str) -> Iterator[tuple[int, Path]]:
    """Existing paths (number, path) that match a pattern with `{frame}` in one of its parts."""
    parts = Path(pattern).parts
    at = next(i for i, part in enumerate(parts) if "{" in part)
    above = root.joinpath(*parts[:at])
    expression = re.compile(
        "".join(
            re.escape(text) + ("" if field is None else r"(\d+)")
            for text, field in _fields(parts[at])
        )
    )
    for path in sorted(above.iterdir()) if above.is_dir() else ():
        match = expression.fullmatch(path.name)
        if match is None or _fill(parts[at], int(match[1])) != path.name:
            continue
        number = int(match[1])
        whole = path.joinpath(*(_fill(part, number) for part in parts[at + 1 :]))
        if whole.exists():
            yield number, whole


def _fields(pattern: str) -> list[tuple[str, str | None]]:
    """Pairs (text, format of the number after it or None) of a pattern."""
    try:
        parsed = list(string.Formatter().parse(pattern))
    except ValueError as error:
        raise ConfigError(
            f"{quoted(pattern)}: {error}. Write {{frame}} or {{frame:06d}}."
        ) from error
    for _, field, spec, conversion in parsed:
        good = (
            field == "frame" and not conversion and re.fullmatch(r"(0?[0-9]{1,2})?d?", spec or "")
        )
        if field is not None and not good:
            raise ConfigError(
                f"{quoted(pattern)}: expected {{frame}} or {{frame:06d}} in the braces, 99 digits "
                f"at most."
            )
    if sum(field is not None for _, field, _, _ in parsed) > 1:
        raise ConfigError(f"{quoted(pattern)} has the number twice in one name; write it once.")
    return [(text, None if field is None else spec or "") for text, field, spec, _ in parsed]


def _fill(pattern: str, number: int) -> str:
    return "".join(
        text + ("" if spec is None else format(number, spec)) for text, spec in _fields_of(pattern)
    )


def _fields_of(pattern: str) -> list[tuple[str, str | None]]:
    """`_fields` of all parts of a path."""
    out: list[tuple[str, str | None]] = []
    for i, part in enumerate(pattern.split("/")):
        out += [("/", None)] if i else []
        out += _fields(part)
    return out


def _add(found: dict[int, Path], number: int, path: Path) -> None:
    if number in found:
        raise DatasetError(
            f"{path.parent} has frame {number} twice, {found[number].name} and {path.name}. Move "
            f"one of them away."
        )
    found[number] = path
