"""Native builds: the libraries for any of Blender's platforms, compiled on any machine.

The compiler is zig (clang with the C libraries of all platforms), so a Linux library needs no newer
glibc than Blender. Without zig, the system's compiler builds for this machine only.
"""

import os
import platform
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from moltenvk import moltenvk

ROOT = Path(__file__).resolve().parents[2]
GLIBC = (2, 28)
"""Minimum version for Blender on Linux."""


@dataclass(frozen=True, kw_only=True)
class Platform:
    """One of Blender's platforms, with its names in zig, CMake, wheels and ctypes."""

    zig: str
    system: str
    processor: str
    tag: str
    library: str


_LINUX = f"linux-gnu.{GLIBC[0]}.{GLIBC[1]}"
_MANYLINUX = f"manylinux_{GLIBC[0]}_{GLIBC[1]}"
PLATFORMS = {
    "linux-x64": Platform(
        zig=f"x86_64-{_LINUX}",
        system="Linux",
        processor="x86_64",
        tag=f"{_MANYLINUX}_x86_64",
        library="libgscore.so",
    ),
    "linux-arm64": Platform(
        zig=f"aarch64-{_LINUX}",
        system="Linux",
        processor="aarch64",
        tag=f"{_MANYLINUX}_aarch64",
        library="libgscore.so",
    ),
    "windows-x64": Platform(
        zig="x86_64-windows-gnu",
        system="Windows",
        processor="AMD64",
        tag="win_amd64",
        library="gscore.dll",
    ),
    "macos-x64": Platform(
        zig="x86_64-macos.11.0",
        system="Darwin",
        processor="x86_64",
        tag="macosx_11_0_x86_64",
        library="libgscore.dylib",
    ),
    "macos-arm64": Platform(
        zig="aarch64-macos.11.0",
        system="Darwin",
        processor="arm64",
        tag="macosx_11_0_arm64",
        library="libgscore.dylib",
    ),
}


def this_platform() -> str:
    """Blender's name of this platform."""
    system = {"Darwin": "macos"}.get(platform.system(), platform.system().lower())
    machine = {"x86_64": "x64", "amd64": "x64", "aarch64": "arm64"}
    processor = platform.machine().lower()
    return f"{system}-{machine.get(processor, processor)}"


def needed_glibc(library: Path) -> tuple[int, int]:
    """The glibc version that a Linux library needs, from its symbol versions."""
    found = re.findall(rb"GLIBC_(\d+)\.(\d+)", library.read_bytes())
    return max((int(major), int(minor)) for major, minor in found)


def gpu_library(library: str) -> str:
    """File name of the library for graphics cards, from that of the other."""
    return library.replace("gscore", "gscore_gpu")


def compile_with_zig(name: str, zig_python: Path) -> tuple[dict[str, Path], str]:
    """Compile the libraries for a platform.

    Args:
        name: One of PLATFORMS.
        zig_python: A Python with the package ziglang.

    Returns:
        The libraries by the names they are installed with, and the platform tag of the wheel.
    """
    target = PLATFORMS[name]
    build = ROOT / "build" / f"zig-{name}"
    # CMake reads CXX once, so it includes the flags; -s strips debug symbols.
    environment = {
        **os.environ,
        "CXX": f"{zig_python} -m ziglang c++ -target {target.zig} -s",
        "ZIG_GLOBAL_CACHE_DIR": str(ROOT / "build" / "zig-cache"),
    }
    _cmake(build, environment, target)
    libraries = _libraries(build, target.library)
    for library in libraries.values():
        if target.system == "Linux" and needed_glibc(library) > GLIBC:
            raise RuntimeError(f"{library} needs glibc {needed_glibc(library)}")
    return libraries, target.tag


def compile_here() -> tuple[dict[str, Path], str]:
    """Like `compile_with_zig`, but with the system's compiler, for this machine only."""
    target = PLATFORMS[this_platform()]
    build = ROOT / "build" / "system"
    _cmake(build, dict(os.environ), target)
    libraries = _libraries(build, target.library)
    return libraries, tag_of(libraries)


def libraries_at(library: Path) -> dict[str, Path]:
    """A compiled library, and that for graphics cards if it is in the same folder, by name."""
    gpu = library.with_name(gpu_library(library.name))
    return {path.name: path for path in (library, gpu) if path == library or path.exists()}


def tag_of(libraries: dict[str, Path]) -> str:
    """The platform tag of a wheel with libraries compiled on this machine."""
    if platform.system() != "Linux":
        return PLATFORMS[this_platform()].tag
    major, minor = max(map(needed_glibc, libraries.values()))
    return f"manylinux_{major}_{minor}_{platform.machine()}"


def _cmake(build: Path, environment: dict[str, str], target: Platform) -> None:
    """Configure and build. Setting the system name keeps the library of the checkout unchanged."""
    tools = Path(sys.executable).parent
    configure = ["-G", "Ninja", "-S", ROOT / "csrc", "-B", build, "-DCMAKE_BUILD_TYPE=Release"]
    configure += [
        f"-DCMAKE_MAKE_PROGRAM={tools / 'ninja'}",
        f"-DCMAKE_SYSTEM_NAME={target.system}",
        f"-DCMAKE_SYSTEM_PROCESSOR={target.processor}",
    ]
    for step in (configure, ["--build", build]):
        done = subprocess.run(
            [tools / "cmake", *step], env=environment, capture_output=True, text=True, check=False
        )
        if done.returncode != 0:
            raise RuntimeError(f"cmake failed in {build}:\n{done.stdout[-3000:]}{done.stderr}")


def _libraries(build: Path, name: str) -> dict[str, Path]:
    """The libraries in a build folder by the names they are installed with; for macOS also those
    that the one for graphics cards needs."""
    found = {each: _library(build, each) for each in (name, gpu_library(name))}
    return found | (moltenvk() if name.endswith(".dylib") else {})


def _library(build: Path, name: str) -> Path:
    """A library in a build folder; MinGW prefixes a DLL's name with `lib`."""
    for path in (build / name, build / f"lib{name}"):
        if path.exists():
            return path
    raise RuntimeError(f"{build}: the build made no {name}")
