"""Unsupported formats: detection of files by content, with a remedy for each.

One table for every place where a capture or a PLY was expected and something else was given.
"""

import shlex
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from ..errors import GsError
from ..text_format import count_words
from .block_record import BLOCK_RECORD
from .file_sample import FileSample, sample_file
from .foreign_cameras import METASHAPE_EXPORT, REALITYSCAN_EXPORT, foreign_cameras, foreign_index
from .lod_index import KIND
from .runs import CAPTURE

_MOST_NAMES = 10_000
"""Of a folder that are looked at."""
_PHOTOS = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp", ".heic", ".dng", ".cr2")
_SPLATS = (
    "It is a trained model: look at it with gscore info or gscore render, or give the photos and "
    "cameras of a capture."
)
_MODEL = ", not a capture"
_SCENE = (
    "If it holds splats, look at them with gscore info or gscore render; for a training give the "
    "photos and cameras of a capture."
)
_CLOUD = (
    "It has points without cameras. Export the cameras in COLMAP's format from the program that "
    "made it, and give the folder that holds them and the photos."
)
_COLMAP = (
    "Export the cameras from that program in COLMAP's format, with undistorted photos, or run "
    "COLMAP on the photos, and give the folder that holds both."
)
_WITH_PHOTOS = "Give the folder that holds it and the photos."
_UNPACK = "Unpack it and give what it holds."
_MESH = "It holds meshes. Give the 3DGS PLY of splats, or the photos and cameras of a capture."
_MOVIE = "Find them first with gscore sfm, or give it to gscore train, which does both."


@dataclass(frozen=True)
class _Format:
    name: str
    advice: str
    holds: Callable[[FileSample], bool]
    but: str = ", which gscore does not read"


def _starts(*magics: bytes) -> Callable[[FileSample], bool]:
    return lambda s: s.head.startswith(magics)


def _text(*words: bytes) -> Callable[[FileSample], bool]:
    """XML or another text in whose beginning one of the words stands."""
    return lambda s: b"\0" not in s.head and any(word in s.head for word in words)


def _zip_of(*names: bytes) -> Callable[[FileSample], bool]:
    return lambda s: s.is_zip_of(*names)


def _ends(*endings: str) -> Callable[[FileSample], bool]:
    return lambda s: s.ending in endings


def _is_splat(s: FileSample) -> bool:
    return s.ending == ".splat" and s.size % 32 == 0  # rows of 32 bytes, and nothing else


def _is_movie(s: FileSample) -> bool:
    boxes = (b"ftyp", b"moov", b"mdat", b"wide")
    is_still = s.head[8:12] in (b"heic", b"heix", b"mif1", b"avif")
    is_riff = s.head.startswith(b"RIFF") and s.head[8:12] == b"AVI "
    is_box = s.head[4:8] in boxes and not is_still
    return is_box or is_riff or s.head.startswith(b"\x1a\x45\xdf\xa3")


_FORMATS = (
    _Format("a file of levels of detail", "gscore render, info and convert take it, and Blender's "
            "import; for all else write splats of it: gscore convert IN.lod out.ply --level 0.",
            _starts(f"{KIND}\n".encode()), ", not of splats"),
    _Format("a compressed splat file of Niantic (SPZ)", _SPLATS,
            lambda s: b"NGSP" in (s.head[:4], s.inflated[:4]), _MODEL),
    _Format("a splat file of PlayCanvas (SOG)", _SPLATS, _zip_of(b"meta.json", b".webp"), _MODEL),
    _Format("a PyTorch checkpoint", "Export a 3DGS PLY with the program that wrote it, and give "
            "that.", _zip_of(b"/data.pkl")),
    _Format("a USD scene", _SCENE,
            lambda s: _starts(b"PXR-USDC", b"#usda")(s) or _zip_of(b".usd")(s), _MODEL),
    _Format("a ZIP archive", _UNPACK, _starts(b"PK\x03\x04", b"PK\x05\x06")),
    _Format("an archive", _UNPACK,
            _starts(b"\x1f\x8b", b"7z\xbc\xaf\x27\x1c", b"Rar!", b"BZh", b"\xfd7zXZ")),
    _Format("a glTF scene", _SCENE,
            lambda s: _starts(b"glTF")(s)
            or (_text(b'"asset"')(s) and _text(b'"version"')(s) and s.ending == ".gltf"),
            _MODEL),
    _Format("a Blender file", "Open it in Blender and export its splats with the add-on.",
            _starts(b"BLENDER")),
    _Format("an E57 point cloud", _CLOUD, _starts(b"ASTM-E57")),
    _Format("a LAS or LAZ point cloud", _CLOUD, _starts(b"LASF")),
    _Format("the database of COLMAP", "Give the folder with the model that COLMAP's mapper wrote, "
            "sparse/0, and the photos.", _starts(b"SQLite format 3")),
    _Format("a project of Metashape", METASHAPE_EXPORT,
            lambda s: _text(b"<document")(s) and s.ending in (".psx", ".psz")),
    _Format("a camera file of Metashape", _WITH_PHOTOS,
            lambda s: _text(b"<document")(s) and _text(b"<chunk", b"<cameras")(s), ", not splats"),
    _Format("a project of RealityScan (RealityCapture)", REALITYSCAN_EXPORT,
            _text(b"<RealityCapture", b"<RealityScan")),
    _Format("a camera file of RealityScan (RealityCapture)", _WITH_PHOTOS,
            _text(b"xcr:", b"capturingreality.com"), _MODEL),
    _Format("a Blocks Exchange file of ContextCapture", _COLMAP, _text(b"<BlocksExchange")),
    _Format("a mesh of FBX", _MESH, _starts(b"Kaydara FBX Binary")),
    _Format("a mesh (OBJ or STL)", _MESH, _ends(".obj", ".stl")),
    _Format("a video", _MOVIE, _is_movie, but=" without cameras"),
    _Format("a single photo", "Give the folder of the photos.",
            lambda s: _starts(b"\xff\xd8\xff", b"\x89PNG", b"II*\0", b"MM\0*")(s)
            or s.head[8:12] in (b"WEBP", b"heic", b"heix", b"mif1", b"avif")),
    _Format("a splat file of antimatter15's viewer (.splat)", _SPLATS, _is_splat, _MODEL),
    _Format("a splat file of mkkellogg's viewer (.ksplat)", _SPLATS, _ends(".ksplat"),
            _MODEL),
)  # fmt: skip
"""What is told apart, the first that fits; those without a signature by their ending, last."""


def describe_unsupported(path: Path) -> str:
    """A sentence on what a file or folder is that gscore does not read, and what to do with it.

    Args:
        path: A file, or a folder in which no capture and no model was found.

    Returns:
        Empty where that is not known.
    """
    try:
        return _folder(path) if path.is_dir() else _file(path)
    except (OSError, ValueError, GsError):
        return ""  # whoever wanted to read it says why it cannot be


def _file(path: Path) -> str:
    if text := foreign_index(path):
        return text
    sample = sample_file(path)
    found = next((kind for kind in _FORMATS if kind.holds(sample)), None)
    return f"{path} is {found.name}{found.but}. {found.advice}" if found else foreign_cameras(path)


def _folder(path: Path) -> str:
    names = list(islice(path.iterdir(), _MOST_NAMES))
    if told := _ours(path, sorted(n for n in names if n.is_dir())):
        return told
    if text := foreign_index(path):
        return text
    if (path / "meta.json").is_file() and any(n.suffix == ".webp" for n in names):
        return f"{path} is an unpacked splat file of PlayCanvas (SOG){_MODEL}. {_SPLATS}"
    below = sum(_photos(n) for n in names if n.is_dir() and not n.name.startswith("."))
    for place in (path / "images", path / "input", path):
        count = _photos(place) + (below if place == path else 0)
        if count:
            return (
                f"{place} holds {count_words(count, 'photo')}, but no cameras for them. Find them "
                f"first: gscore sfm {_argument(path)} -o {_argument(_capture(path, place))}"
            )
    others = sorted(n for n in names if n.is_file() and n.suffix.lower() != ".json")
    return next((told for told in map(_file, others[:20]) if told), "")


def _ours(path: Path, folders: list[Path]) -> str:
    """What a folder is that gscore wrote."""
    if any((folder / BLOCK_RECORD).is_file() for folder in folders):
        blocks = [folder for folder in folders if (folder / BLOCK_RECORD).is_file()]
        return (
            f"{path} holds {count_words(len(blocks), 'block')} of a capture. gscore train "
            f"{_argument(path)} -o RUNS trains all; each is a capture too, {blocks[0]} the first."
        )
    if _is_run(path):
        capture = path / CAPTURE
        where = f"Its capture is {capture}." if capture.is_dir() else "Give the capture."
        return f"{path} is the folder of a training. {where}"
    runs = [folder for folder in folders if _is_run(folder)]
    if runs:
        return (
            f"{path} holds {count_words(len(runs), 'training')}, {runs[0]} the first: give one. "
            f"Those of blocks are put together by gscore merge {_argument(path)} -o splats.ply."
        )
    return ""


def _is_run(folder: Path) -> bool:
    return all((folder / name).is_file() for name in ("config.json", "point_cloud.ply"))


def _capture(path: Path, place: Path) -> Path:
    """Where `gscore sfm` is to put the capture: in place where the photos are in `images`."""
    if place.name == "images" and place != path:
        return path
    whole = path.absolute()
    return (
        path.parent / f"{whole.name}-capture" if path.name else Path("..", f"{whole.name}-capture")
    )


def _argument(path: Path) -> str:
    """The path as a shell takes it."""
    return shlex.quote(str(path))


def _photos(folder: Path) -> int:
    if not folder.is_dir():
        return 0
    names = islice(folder.iterdir(), _MOST_NAMES)
    return sum(name.suffix.lower() in _PHOTOS for name in names)
