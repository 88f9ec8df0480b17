"""Foreign cameras: detection of unreadable camera and tile files, with export instructions."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from ..errors import GsError
from .file_sample import FileSample, sample_file

_MOST_NAMES = 10_000
"""Most names of a folder that are checked."""
_NERFSTUDIO = (
    "Convert it with nerfstudio's ns-process-data {} to a transforms.json, and give that folder."
)
_COLMAP = "Export the cameras in COLMAP's format from that program, with undistorted photos."
METASHAPE_EXPORT = (
    "Export the cameras with File > Export > Export Cameras as Agisoft XML, or in COLMAP's format, "
    "and put the file into the folder of the photos."
)
REALITYSCAN_EXPORT = (
    "Export the cameras with Alignment > Export > Registration as Internal/External Camera "
    "Parameters (CSV), or in COLMAP's format, and put the file into the folder of the photos."
)


@dataclass(frozen=True)
class _Kind:
    name: str
    advice: str
    names: tuple[str, ...]
    """Lower-case file names, or their ends if they begin with a dot or underscore."""
    matches: Callable[[FileSample], bool] = lambda sample: True


def _has(*words: bytes) -> Callable[[FileSample], bool]:
    """True for files whose first bytes contain all the words."""
    return lambda sample: all(word in sample.head for word in words)


_CAMERAS = (
    _Kind("a project of Metashape", METASHAPE_EXPORT, (".psx", ".psz")),
    _Kind("a project or component of RealityScan (RealityCapture)", REALITYSCAN_EXPORT,
          (".rcproj", ".rsproj", ".rcalign", ".rsalign")),
    _Kind("a camera file of Bundler", "It states no size of the photos, and programs disagree on "
          f"its axes. {_COLMAP}", (".out",), _has(b"# Bundle file")),
    _Kind("a camera file of VisualSFM (NVM)", _COLMAP, (".nvm",), _has(b"NVM_V3")),
    _Kind("a Blocks Exchange file of ContextCapture", _COLMAP, (".xml",),
          _has(b"<BlocksExchange")),
    _Kind("a camera file of OpenMVG", "Convert it with openMVG_main_openMVG2Colmap.", (".json",),
          _has(b'"sfm_data_version"')),
    _Kind("a camera file of Meshroom (AliceVision)", "Add its node ExportColmap, and give the "
          "folder that it writes.", (".sfm", ".json"), _has(b'"featuresFolders"')),
    _Kind("a camera file of Pix4D", _COLMAP, ("_calibrated_camera_parameters.txt", ".p4d",
          "_calibrated_external_camera_parameters.txt")),
    _Kind("a capture of Polycam", _NERFSTUDIO.format("polycam"), ("mesh_info.json",)),
    _Kind("a capture of Record3D", _NERFSTUDIO.format("record3d"), (".r3d",)),
    _Kind("a capture of Record3D", _NERFSTUDIO.format("record3d"), ("metadata",),
          _has(b'"poses"', b'"K"')),
    _Kind("a file of poses in the layout of transforms.json", "Give that file itself, or call it "
          "transforms.json.", (".json",), _has(b'"frames"', b'"transform_matrix"')),
)  # fmt: skip
_INDEXES = (
    _Kind("the index of a 3D Tiles tileset", "It lists tiles without splats: give a glTF tile "
          "(.glb or .gltf) with splats, or join the tiles in the program that made them.",
          ("tileset.json",), _has(b'"root"', b'"geometricError"')),
    _Kind("the index of a Streamed SOG of PlayCanvas", "It lists chunks without splats: give the "
          "meta.json of a chunk, or join them into one file with splat-transform.",
          ("lod-meta.json",)),
)  # fmt: skip


def foreign_index(path: Path) -> str:
    """Message if a file, or a file in a folder, is the index of splats in many files; else
    empty."""
    names = [name for kind in _INDEXES for name in kind.names]
    return _named(path, _INDEXES) or next(
        (text for name in names if (text := _named(path / name, _INDEXES))), ""
    )


def unread_cameras(folder: Path) -> str:
    """Message about unsupported camera or splat files in a folder of photos; empty without any.

    Args:
        folder: Folder of the photos, or its parent.
    """
    if not folder.is_dir():
        return ""
    try:
        files = sorted(p for p in islice(folder.iterdir(), _MOST_NAMES) if p.is_file())
    except OSError:
        return ""  # listing the photos reports the error
    message = next((text for file in files if (text := _named(file, _INDEXES))), "")
    if message:
        return message
    message = next((text for file in files if (text := _named(file, _CAMERAS))), "")
    return message.replace(". ", ", whose cameras are not read. ", 1) if message else ""


def foreign_cameras(path: Path) -> str:
    """Message if a file is an unsupported camera file; else empty."""
    return _named(path, _CAMERAS)


def _named(path: Path, kinds: tuple[_Kind, ...]) -> str:
    name = path.name.lower()
    candidates = [
        kind
        for kind in kinds
        if any(name == end or (end[0] in "._" and name.endswith(end)) for end in kind.names)
    ]
    try:
        sample = sample_file(path) if candidates and path.is_file() else None
    except (OSError, ValueError, GsError):
        return ""
    if sample is None:
        return ""
    match = next((kind for kind in candidates if kind.matches(sample)), None)
    return f"{path} is {match.name}. {match.advice}" if match else ""
