"""Finder of other programs' camera files in a folder, by content instead of name."""

from dataclasses import dataclass, replace
from pathlib import Path

from . import metashape, realityscan

_HEAD = 1 << 13
"""Bytes read from the start of a file."""
_RECONSTRUCTIONS = ("reconstruction.json", "opensfm/reconstruction.json")
_BOUNDS = "poses_bounds.npy"


@dataclass(frozen=True, kw_only=True)
class ProgramFile:
    """A supported camera file."""

    program: str
    """`RealityScan CSV`, `Metashape XML`, `OpenSfM`, `LLFF` or `RealityScan XMP`."""
    path: Path
    """The file; for XMP sidecars their common folder."""
    root: Path
    """Folder of the capture."""
    others: tuple[Path, ...] = ()
    """Other camera files in the folder, which are not read."""


def find_program(source: Path, images: str = "images", *, below: bool = True) -> ProgramFile | None:
    """The camera file at or in `source` or its folder of photos, or None; XMP sidecars if there is
    no other.

    Args:
        source: A file, or the folder of a capture.
        images: Folder of the photos in it.
        below: Search sidecars in all folders below; else only in those two, for folders with
            unknown content.
    """
    if source.is_file():
        return _of_file(source, source.parent)
    if not source.is_dir():
        return None
    known = [
        found
        for folder in dict.fromkeys((source, source / images, source / "input"))
        if folder.is_dir()
        for path in _candidates(folder)
        if (found := _of_file(path, source))
    ]
    if known:
        return replace(known[0], others=tuple(other.path for other in known[1:]))
    photos = source / images if (source / images).is_dir() else source
    if any(realityscan.sidecars_in(photos, below=below)):
        return ProgramFile(program="RealityScan XMP", path=photos, root=source)
    return None


def _candidates(folder: Path) -> list[Path]:
    files = sorted(p for p in folder.iterdir() if p.suffix.lower() in (".csv", ".xml"))
    return files + [folder / name for name in (*_RECONSTRUCTIONS, _BOUNDS)]


def _of_file(path: Path, root: Path) -> ProgramFile | None:
    if not path.is_file():
        return None
    ending, program = path.suffix.lower(), ""
    if ending == ".csv" and realityscan.is_csv(_head(path)):
        program = "RealityScan CSV"
    elif ending == ".xml" and metashape.is_xml(_head(path)):
        program = "Metashape XML"
    elif path.name == "reconstruction.json" and '"cameras"' in _head(path):
        program = "OpenSfM"
    elif path.name == _BOUNDS:
        program = "LLFF"
    return ProgramFile(program=program, path=path, root=root) if program else None


def _head(path: Path) -> str:
    """First bytes of a file as text, in any encoding with ASCII letters."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
    return head.replace(b"\0", b"").decode("latin-1").removeprefix("\u00ef\u00bb\u00bf")
