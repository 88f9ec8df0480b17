"""MoltenVK for zips and wheels of macOS: Vulkan on Apple's Metal, which macOS does not have itself.

Nobody publishes it alone where Python packages come from, so it is taken from the macOS wheel of
Quadrants, whose build is that of the MoltenVK project, for both processors.
"""

import hashlib
import subprocess
import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "build" / "moltenvk"
SOURCE = "quadrants==1.1.3"
MEMBER = "quadrants/_lib/runtime/libMoltenVK.dylib"
SHA256 = "45f81ce6bd517b6bc904f252b84ebe30177e791143144cc81eb0a1e99e840c0a"
NOTICE = """libMoltenVK.dylib is MoltenVK, copyright The Brenwill Workshop Ltd. and the Khronos
Group, https://github.com/KhronosGroup/MoltenVK, unchanged, under this licence:

"""


def moltenvk() -> dict[str, Path]:
    """The library and its notice by the names they are installed with; downloads 60 MB once.

    Raises:
        RuntimeError: it cannot be downloaded, or is not the one expected.
    """
    library, notice = FOLDER / "libMoltenVK.dylib", FOLDER / "libMoltenVK.txt"
    if not library.is_file():
        FOLDER.mkdir(parents=True, exist_ok=True)
        partial = library.with_suffix(".partial")
        partial.write_bytes(_downloaded())
        partial.replace(library)
    if hashlib.sha256(library.read_bytes()).hexdigest() != SHA256:
        raise RuntimeError(f"{library} is not the library of {SOURCE}; delete it and try again")
    terms = ROOT / "csrc" / "third_party" / "LICENSE-Apache-2.0.txt"
    notice.write_text(NOTICE + terms.read_text(encoding="utf-8"), encoding="utf-8")
    return {path.name: path for path in (library, notice)}


def _downloaded() -> bytes:
    """The library from the wheel."""
    platform = ["--platform", "macosx_11_0_arm64", "--python-version", "3.11"]
    pip = [sys.executable, "-m", "pip", "download", "-q", "--disable-pip-version-check"]
    options = ["--no-deps", "--only-binary=:all:", *platform, "-d", str(FOLDER)]
    done = subprocess.run([*pip, *options, SOURCE], capture_output=True, text=True, check=False)
    wheels = sorted(FOLDER.glob("quadrants-*.whl"))
    if done.returncode != 0 or not wheels:
        raise RuntimeError(
            f"{SOURCE}, which contains MoltenVK, cannot be downloaded: {done.stderr}"
        )
    with zipfile.ZipFile(wheels[0]) as archive:
        data = archive.read(MEMBER)
    for wheel in wheels:
        wheel.unlink()
    return data
