"""Blender extension build: a zip per platform in dist/, checked by Blender's validator.

`python tools/build/build_extension.py` builds the zip for this platform; `all` or names such as
`windows-x64 macos-arm64` build others. Each contains the add-on and the wheels of gscore and
plyfile. `--library` uses a library that is already compiled for this machine.
"""

import argparse
import base64
import hashlib
import re
import shutil
import subprocess
import sys
import tomllib
import venv
import zipfile
from pathlib import Path

import bpy_venvs
import native_builds
from error_exit import exit_with_message
from manual_page import manual, manual_page

ROOT = native_builds.ROOT
STAGE = ROOT / "build" / "extension"
ZIG = ROOT / ".venv-zig"
PLYFILE = "plyfile==1.1.5"
ZIGLANG = "ziglang==0.17.0"
_MARK = re.compile(r"^# tools/build/build_extension\.py puts .*$", re.MULTILINE)
_MEASURES = ("bench/", "stress/", "commands/bench/", "commands/stress.py")
"""Files of measurements, which Blender does not need: its wheel leaves them out."""
_DATE = (2020, 1, 1, 0, 0, 0)
"""Date of every member, so that equal sources give equal zips."""


def build_wheels() -> tuple[Path, Path]:
    """The wheels of gscore, without its libraries, and of plyfile, both for any platform."""
    folder = STAGE / "wheels"
    shutil.rmtree(folder, ignore_errors=True)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    no_library = "--config-settings=wheel.cmake=false"
    subprocess.run([*pip, "wheel", "-q", "--no-deps", no_library, "-w", folder, ROOT], check=True)
    only_wheels = ["--no-deps", "--only-binary=:all:", "-d", folder]
    subprocess.run([*pip, "download", "-q", *only_wheels, PLYFILE], check=True)
    (gscore,) = folder.glob("gscore-*.whl")
    (plyfile,) = folder.glob("plyfile-*.whl")
    return gscore, plyfile


def add_libraries(
    wheel: Path, libraries: dict[str, Path], tag: str, folder: Path, *, for_blender: bool = True
) -> Path:
    """A copy of a wheel with the native libraries and the platform's tag.

    For Blender it leaves out measurements, and its version includes a hash of the content, because
    Blender does not unpack a wheel again if it knows its name and version.
    """
    project, version, *_ = wheel.name.split("-")
    old = f"{project}-{version}.dist-info"
    with zipfile.ZipFile(wheel) as archive:
        left_out = tuple(f"gscore/{name}" for name in _MEASURES if for_blender)
        kept = [entry for entry in archive.namelist() if not entry.startswith(left_out)]
        members = {entry: archive.read(entry) for entry in kept if entry[-1] != "/"}
    del members[f"{old}/RECORD"]
    members |= {f"gscore/raster/{name}": path.read_bytes() for name, path in libraries.items()}
    tags = members[f"{old}/WHEEL"].decode()
    tags = tags.replace("Root-Is-Purelib: true", "Root-Is-Purelib: false")
    members[f"{old}/WHEEL"] = tags.replace("py3-none-any", f"py3-none-{tag}").encode()
    own = version
    if for_blender:
        own += f"+{hashlib.sha256(_record(members, '')).hexdigest()[:8]}"
    metadata = members[f"{old}/METADATA"].decode()
    metadata = metadata.replace(f"\nVersion: {version}\n", f"\nVersion: {own}\n", 1)
    members[f"{old}/METADATA"] = metadata.encode()
    info = f"{project}-{own}.dist-info"
    members = {entry.replace(old, info, 1): data for entry, data in members.items()}
    members[f"{info}/RECORD"] = _record(members, f"{info}/RECORD")
    path = folder / f"{project}-{own}-py3-none-{tag}.whl"
    write_zip(path, members)
    return path


def _record(members: dict[str, bytes], own: str) -> bytes:
    """The RECORD of a wheel: name, SHA-256 and size of every member."""
    lines = []
    for name, data in sorted(members.items()):
        digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
        lines.append(f"{name},sha256={digest},{len(data)}")
    return "\n".join([*lines, f"{own},,", ""]).encode()


def write_zip(path: Path, members: dict[str, bytes]) -> None:
    """Write a zip that depends only on its members."""
    partial = path.with_suffix(".partial")
    with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, data in sorted(members.items()):
            entry = zipfile.ZipInfo(name, _DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data)
    partial.replace(path)


def manifest(platform: str, wheels: list[Path]) -> str:
    """The manifest of one zip, with the version of gscore."""
    text = (ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    names = ", ".join(f'"./wheels/{wheel.name}"' for wheel in wheels)
    text, marks = _MARK.subn(f'platforms = ["{platform}"]\nwheels = [{names}]', text)
    if marks != 1:
        raise RuntimeError("blender_manifest.toml: the comment that marks the wheels is missing")
    stated, version = tomllib.loads(text)["version"], re.split("[-+]", wheels[0].name)[1]
    if stated != version:
        raise RuntimeError(f"blender_manifest.toml: version {stated}, but gscore has {version}")
    return text


def build_zip(
    platform: str, libraries: dict[str, Path], tag: str, wheels: tuple[Path, Path], output: Path
) -> Path:
    """Put add-on, manifest and wheels of a platform into a zip in the folder `output`."""
    stage = STAGE / platform
    shutil.rmtree(stage, ignore_errors=True)
    stage.mkdir(parents=True)
    gscore = add_libraries(wheels[0], libraries, tag, stage)
    text = manifest(platform, [gscore, wheels[1]])
    sources = [ROOT / "__init__.py", ROOT / "LICENSE"]
    sources += [p for p in (ROOT / "addon").rglob("*") if p.is_file() and p.suffix != ".pyc"]
    members = {path.relative_to(ROOT).as_posix(): path.read_bytes() for path in sources}
    members |= {f"wheels/{wheel.name}": wheel.read_bytes() for wheel in (gscore, wheels[1])}
    members["manual.html"] = manual_page(manual(ROOT / "docs")).encode()
    members["blender_manifest.toml"] = text.encode()
    values = tomllib.loads(text)
    output.mkdir(parents=True, exist_ok=True)
    path = output / f"{values['id']}-{values['version']}-{platform.replace('-', '_')}.zip"
    write_zip(path, members)
    return path


def validate(path: Path) -> list[str]:
    """Validate a zip with every available Blender; returns their versions.

    Raises:
        RuntimeError: one of them rejects it, with its message.
    """
    checks = {}
    for version in bpy_venvs.installed() or [bpy_venvs.choose("newest")[0]]:
        packages = bpy_venvs.ensure(version).parent.parent
        script = next(packages.rglob("bl_pkg/cli/blender_ext.py"))
        checks[version] = [sys.executable, script, "validate", path]
    if program := shutil.which("blender"):
        checks[program] = [program, "--command", "extension", "validate", path]
    for version, command in checks.items():
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise RuntimeError(f"Blender {version} rejects {path}:\n{done.stdout}{done.stderr}")
    return list(checks)


def zig_python() -> Path | None:
    """A Python with zig, installed into .venv-zig on first use; None if that fails."""
    python = ZIG / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    if not (ZIG / ".installed").exists():
        print(f"Installing {ZIGLANG} into .venv-zig (downloads 90 MB)", file=sys.stderr)
        venv.create(ZIG, clear=True, with_pip=True)
        pip = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check", ZIGLANG]
        if subprocess.run(pip, check=False).returncode != 0:
            return None
        (ZIG / ".installed").touch()
    return python


def compile_all(platforms: list[str]) -> dict[str, tuple[dict[str, Path], str]]:
    """The libraries and the wheel's tag for each platform, with the best available compiler."""
    if (zig := zig_python()) is not None:
        return {name: native_builds.compile_with_zig(name, zig) for name in platforms}
    here = native_builds.this_platform()
    if platforms != [here]:
        raise RuntimeError(f"{ZIGLANG}, needed for other platforms, cannot be installed")
    libraries, tag = native_builds.compile_here()
    print(f"{ZIGLANG} cannot be installed; using the system's compiler: {tag}")
    return {here: (libraries, tag)}


def parse() -> argparse.Namespace:
    """The command line, with expanded `platforms`."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    known, here = list(native_builds.PLATFORMS), native_builds.this_platform()
    parser.add_argument("platforms", nargs="*", help=f"all, or some of {', '.join(known)}")
    parser.add_argument("--library", type=Path, help="compiled library for this machine")
    parser.add_argument("--output", type=Path, default=ROOT / "dist", help="folder for the zips")
    options = parser.parse_args()
    options.platforms = known if options.platforms == ["all"] else options.platforms or [here]
    if unknown := [name for name in options.platforms if name not in known]:
        parser.error(f"{', '.join(unknown)}: choose all, or some of {', '.join(known)}")
    if options.library and options.platforms != [here]:
        parser.error(f"--library is for this machine only, {here}")
    return options


@exit_with_message
def main() -> None:
    """Build and validate the zips, and print their paths."""
    options = parse()
    if options.library:
        libraries = native_builds.libraries_at(options.library)
        builds = {options.platforms[0]: (libraries, native_builds.tag_of(libraries))}
    else:
        builds = compile_all(options.platforms)
    wheels = build_wheels()
    for platform, (libraries, tag) in builds.items():
        path = build_zip(platform, libraries, tag, wheels, options.output)
        versions, size = ", ".join(validate(path)), path.stat().st_size / 1e6
        print(f"{path}: {size:.1f} MB, validated by Blender {versions}")


if __name__ == "__main__":
    sys.exit(main())
