"""Unsupported formats: detection of files by content, with a remedy for each.

Used wherever a capture or a PLY was expected and another file was given, and for cameras of other
programs among photos.
"""

import shlex
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from ..errors import GsError
from ..text_format import count_text
from .block_record import BLOCK_RECORD
from .file_sample import FileSample, sample_file
from .lod_index import KIND
from .runs import CAPTURE

_MOST_NAMES = 10_000
"""Most names of a folder that are checked."""
_PHOTOS = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp", ".heic", ".dng", ".cr2")
_SPLATS = (
    "It is a trained model: view it with gscore info or gscore render, or give the photos and "
    "cameras of a capture."
)
_MODEL = ", not a capture"
_SCENE = (
    "If it has splats, view them with gscore info or gscore render; for a training give the photos "
    "and cameras of a capture."
)
_CLOUD = (
    "It has points without cameras. Export the cameras in COLMAP's format from the program that "
    "made it, and give the folder with them and the photos."
)
_COLMAP = (
    "Export the cameras from that program in COLMAP's format, with undistorted photos, or run "
    "COLMAP on the photos, and give the folder with both."
)
_WITH_PHOTOS = "Give the folder with it and the photos."
_REALITYSCAN = (".rcproj", ".rsproj", ".rcalign", ".rsalign")
_UNPACK = "Unpack it and give its content."
_MESH = "It has meshes. Give the 3DGS PLY of splats, or the photos and cameras of a capture."
_NERFSTUDIO = (
    "Convert it with nerfstudio's ns-process-data {} to a transforms.json, and give that folder."
)
_MOVIE = "Find them first with gscore sfm, or give it to gscore train, which does both."


@dataclass(frozen=True)
class _Format:
    name: str
    advice: str
    matches: Callable[[FileSample], bool] | None = None
    """Test of the content; None: the names suffice."""
    but: str = ", which gscore does not read"
    names: tuple[str, ...] = ()
    """Lower-case names of files among photos, or their ends if they begin with a dot or
    underscore."""


def _starts(*magics: bytes) -> Callable[[FileSample], bool]:
    return lambda s: s.head.startswith(magics)


def _text(*words: bytes) -> Callable[[FileSample], bool]:
    """True for XML or other text whose first bytes contain one of the words."""
    return lambda s: b"\0" not in s.head and any(word in s.head for word in words)


def _has(*words: bytes) -> Callable[[FileSample], bool]:
    """True for files whose first bytes contain all the words."""
    return lambda s: all(word in s.head for word in words)


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


_INDEXES = (
    _Format("the index of a 3D Tiles tileset", "It lists tiles without splats: give a glTF tile "
            "(.glb or .gltf) with splats, or join the tiles in the program that made them.",
            _has(b'"root"', b'"geometricError"'), "", ("tileset.json",)),
    _Format("the index of a Streamed SOG of PlayCanvas", "It lists chunks without splats: give the "
            "meta.json of a chunk, or join them into one file with splat-transform.",
            but="", names=("lod-meta.json",)),
)  # fmt: skip
"""Indexes of splats in many files."""
_CAMERAS = (
    _Format("a project of Metashape", "Export the cameras with File > Export > Export Cameras as "
            "Agisoft XML, or in COLMAP's format, and put the file into the folder of the photos.",
            names=(".psx", ".psz")),
    _Format("a project or component of RealityScan (RealityCapture)", "Export the cameras with "
            "Alignment > Export > Registration as Internal/External Camera Parameters (CSV), or in "
            "COLMAP's format, and put the file into the folder of the photos.",
            lambda s: s.ending in _REALITYSCAN or _text(b"<RealityCapture", b"<RealityScan")(s),
            names=_REALITYSCAN),
    _Format("a camera file of Bundler", "It states no size of the photos, and programs disagree on "
            f"its axes. {_COLMAP}", _has(b"# Bundle file"), names=(".out",)),
    _Format("a camera file of VisualSFM (NVM)", _COLMAP, _has(b"NVM_V3"), names=(".nvm",)),
    _Format("a Blocks Exchange file of ContextCapture", _COLMAP, _has(b"<BlocksExchange"),
            names=(".xml",)),
    _Format("a camera file of OpenMVG", "Convert it with openMVG_main_openMVG2Colmap.",
            _has(b'"sfm_data_version"'), names=(".json",)),
    _Format("a camera file of Meshroom (AliceVision)", "Add its node ExportColmap, and give the "
            "folder that it writes.", _has(b'"featuresFolders"'), names=(".sfm", ".json")),
    _Format("a camera file of Pix4D", _COLMAP, names=("_calibrated_camera_parameters.txt", ".p4d",
            "_calibrated_external_camera_parameters.txt")),
    _Format("a capture of Polycam", _NERFSTUDIO.format("polycam"), names=("mesh_info.json",)),
    _Format("a capture of Record3D", _NERFSTUDIO.format("record3d"), names=(".r3d",)),
    _Format("a capture of Record3D", _NERFSTUDIO.format("record3d"),
            lambda s: not s.ending and _has(b'"poses"', b'"K"')(s), names=("metadata",)),
    _Format("a file of poses in the layout of transforms.json", "Give that file itself, or call it "
            "transforms.json.", _has(b'"frames"', b'"transform_matrix"'), "", (".json",)),
)  # fmt: skip
"""Cameras that are not read."""
_FORMATS = (
    _Format("a file of levels of detail", "Use it with gscore render, info and convert, or import "
            "it in Blender; for all else convert it: gscore convert IN.lod out.ply --level 0.",
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
    _Format("a camera file of Metashape", _WITH_PHOTOS,
            lambda s: _text(b"<document")(s) and _text(b"<chunk", b"<cameras")(s), ", not splats"),
    _Format("a camera file of RealityScan (RealityCapture)", _WITH_PHOTOS,
            _text(b"xcr:", b"capturingreality.com"), _MODEL),
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
"""Detected formats, the first match applies; those without a signature are last, by ending."""


def describe_unsupported(path: Path) -> str:
    """Message with the format of an unsupported file or folder and the remedy.

    Args:
        path: A file, or a folder in which no capture and no model was found.

    Returns:
        The message; empty if the format is unknown.
    """
    try:
        return _folder(path) if path.is_dir() else _file(path)
    except (OSError, ValueError, GsError):
        return ""  # reading it reports the error


def unread_cameras(folder: Path) -> str:
    """Message about unsupported camera or splat files in a folder of photos; empty without any.

    Args:
        folder: Folder of the photos, or its parent.
    """
    places = [place for place in (folder, folder / "images", folder / "input") if place.is_dir()]
    try:
        names = [name for place in places for name in islice(place.iterdir(), _MOST_NAMES)]
    except OSError:
        return ""  # listing the photos reports the error
    for kinds, but in ((_INDEXES, ""), (_CAMERAS, ", whose cameras are not read")):
        for path in sorted(names):
            if match := _match(path, kinds, among_photos=True):
                return f"{path} is {match.name}{but}. {match.advice}"
    return ""


def _match(path: Path, kinds: tuple[_Format, ...], *, among_photos: bool) -> _Format | None:
    """The first of these formats that a file has; among photos only files of its names have it."""
    candidates = [
        kind
        for kind in kinds
        if _is_named(path.name.lower(), kind) or (kind.matches and not among_photos)
    ]
    try:
        sample = sample_file(path) if candidates and path.is_file() else None
    except (OSError, ValueError, GsError):
        return None  # reading it reports the error
    if sample is None:
        return None
    return next((k for k in candidates if k.matches is None or k.matches(sample)), None)


def _is_named(name: str, kind: _Format) -> bool:
    return any(name == end or (end[0] in "._" and name.endswith(end)) for end in kind.names)


def _file(path: Path) -> str:
    match = _match(path, (*_INDEXES, *_CAMERAS, *_FORMATS), among_photos=False)
    return f"{path} is {match.name}{match.but}. {match.advice}" if match else ""


def _folder(path: Path) -> str:
    names = list(islice(path.iterdir(), _MOST_NAMES))
    if text := _gscore_folder(path, sorted(n for n in names if n.is_dir())):
        return text
    indexes = (_file(n) for n in names if any(_is_named(n.name.lower(), k) for k in _INDEXES))
    if text := next(filter(None, indexes), ""):
        return text
    if (path / "meta.json").is_file() and any(n.suffix == ".webp" for n in names):
        return f"{path} is an unpacked splat file of PlayCanvas (SOG){_MODEL}. {_SPLATS}"
    below = sum(_photos(n) for n in names if n.is_dir() and not n.name.startswith("."))
    for place in (path / "images", path / "input", path):
        count = _photos(place) + (below if place == path else 0)
        if count:
            return (
                f"{place} has {count_text(count, 'photo')}, but no cameras for them. Find them "
                f"first: gscore sfm {_argument(path)} -o {_argument(_capture(path, place))}"
            )
    others = sorted(n for n in names if n.is_file() and n.suffix.lower() != ".json")
    return next((text for text in map(_file, others[:20]) if text), "")


def _gscore_folder(path: Path, folders: list[Path]) -> str:
    """Message about a folder that gscore wrote; empty for others."""
    if any((folder / BLOCK_RECORD).is_file() for folder in folders):
        blocks = [folder for folder in folders if (folder / BLOCK_RECORD).is_file()]
        return (
            f"{path} has {count_text(len(blocks), 'block')} of a capture. gscore train "
            f"{_argument(path)} -o RUNS trains all; each is a capture too, {blocks[0]} the first."
        )
    if _is_run(path):
        capture = path / CAPTURE
        where = f"Its capture is {capture}." if capture.is_dir() else "Give the capture."
        return f"{path} is the folder of a training. {where}"
    runs = [folder for folder in folders if _is_run(folder)]
    if runs:
        return (
            f"{path} has {count_text(len(runs), 'training')}, {runs[0]} the first: give one. "
            f"Those of blocks are merged by gscore merge {_argument(path)} -o splats.ply."
        )
    return ""


def _is_run(folder: Path) -> bool:
    return all((folder / name).is_file() for name in ("config.json", "point_cloud.ply"))


def _capture(path: Path, place: Path) -> Path:
    """Output folder for `gscore sfm`: in place if the photos are in `images`."""
    if place.name == "images" and place != path:
        return path
    whole = path.absolute()
    return (
        path.parent / f"{whole.name}-capture" if path.name else Path("..", f"{whole.name}-capture")
    )


def _argument(path: Path) -> str:
    """The path quoted for a shell."""
    return shlex.quote(str(path))


def _photos(folder: Path) -> int:
    if not folder.is_dir():
        return 0
    names = islice(folder.iterdir(), _MOST_NAMES)
    return sum(name.suffix.lower() in _PHOTOS for name in names)
