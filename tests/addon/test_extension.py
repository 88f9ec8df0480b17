"""Oracle: Blender's own installer, in fresh processes with empty profiles."""

import base64
import hashlib
import io
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
sys.path.append(str(ROOT / "tools" / "build"))
import build_extension  # noqa: E402

MODULE = "bl_ext.user_default.gscore_splats"

INSTALL = f"""
import sys
import bpy
package = sys.argv[-1]
module = "{MODULE}"
there = lambda: hasattr(bpy.types.Scene, "gscore") and "import_splats" in dir(bpy.ops.gscore)
assert not there()
done = bpy.ops.extensions.package_install_files(
    filepath=package, repo="user_default", enable_on_install=True)
assert done == {{"FINISHED"}}, done
assert module in bpy.context.preferences.addons
assert there()
"""

END = """
# bpy 4.2 crashes at exit once anyone's class with property callbacks has been removed.
import os
sys.stdout.flush()
os._exit(0)
"""

CYCLE = """
import gscore
for name in (gscore.__file__, sys.modules[module].__file__):
    print("FROM", name)
assert bpy.ops.gscore.find_devices() == {"FINISHED"}, "a render server starts"
print("CARDS", bpy.context.preferences.addons[module].preferences.found_devices)
for _ in range(2):
    bpy.ops.preferences.addon_disable(module=module)
    assert not there()
    bpy.ops.preferences.addon_enable(module=module)
    assert there()
print("CLEAN")
"""

UPDATE = (
    """
import gscore
first = gscore.__file__
assert not hasattr(gscore._version, "MARK")
done = bpy.ops.extensions.package_install_files(
    filepath=sys.argv[-2], repo="user_default", enable_on_install=True)
assert done == {"FINISHED"} and there(), done
import gscore
assert gscore.__file__ == first and gscore._version.MARK == 1
core = sys.modules[module + ".addon.core"]
assert core.Splats is gscore.Splats
print("UPDATED")
"""
    + END
)

UNINSTALL = (
    """
import pathlib
import gscore
wheels = pathlib.Path(gscore.__file__).parent.parent
assert (wheels / "plyfile.py").exists()
repos = bpy.context.preferences.extensions.repos
(index,) = [i for i, repo in enumerate(repos) if repo.module == "user_default"]
bpy.ops.extensions.package_uninstall(repo_index=index, pkg_id="gscore_splats")
assert not there() and module not in bpy.context.preferences.addons
assert not (wheels / "plyfile.py").exists() and not (wheels / "gscore").exists()
print("GONE")
"""
    + END
)


@pytest.fixture(scope="session")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The extension of this checkout with its compiled library, validated by Blender."""
    python = ROOT / ".venv" / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    (library,) = [p for p in (ROOT / "gscore" / "raster").glob("*gscore.*") if p.suffix != ".py"]
    output = tmp_path_factory.mktemp("dist")
    done = subprocess.run(
        [
            *(
                python if python.exists() else sys.executable,
                ROOT / "tools/build/build_extension.py",
            ),
            *("--library", library, "--output", output),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "validated by Blender" in done.stdout
    (path,) = output.glob("gscore_splats-*.zip")
    return path


def test_the_zip_is_whole(package: Path) -> None:
    """Oracle: the checkout's files, and the top-level members required by Blender's manual."""
    with zipfile.ZipFile(package) as archive:
        names = set(archive.namelist())
    files = [p for p in (ROOT / "addon").rglob("*") if p.is_file() and p.suffix != ".pyc"]
    ours = {p.relative_to(ROOT).as_posix() for p in files}
    assert "addon/trainer_python/pinned/packages.txt" in ours
    top = {"__init__.py", "blender_manifest.toml", "LICENSE", "manual.html"}
    assert ours | top <= names
    assert not [name for name in names if "__pycache__" in name or name.startswith("tests")]
    assert len([name for name in names if name.startswith("wheels/gscore-")]) == 1


def test_the_wheel_does_without_what_measures(package: Path, tmp_path: Path) -> None:
    """Oracle: the checkout's other files; `gscore stress` in a process that has only the wheel."""
    with zipfile.ZipFile(package) as archive:
        (name,) = [n for n in archive.namelist() if n.startswith("wheels/gscore-")]
        archive.extract(name, tmp_path)
    with zipfile.ZipFile(tmp_path / name) as wheel:
        found = {n for n in wheel.namelist() if n.endswith(".py")}
        wheel.extractall(tmp_path / "there")
    ours = {p.relative_to(ROOT).as_posix() for p in (ROOT / "gscore").rglob("*.py")}
    left_out = {name for name in ours if "bench" in name or "stress" in name}
    assert len(left_out) > 30 and found == ours - left_out

    def gscore(*line: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-S", "-m", "gscore", *line]  # -S: no other gscore
        there = tmp_path / "there"
        return subprocess.run(command, cwd=there, capture_output=True, text=True, check=False)

    usage, refused = gscore(), gscore("stress")
    assert usage.returncode == 2 and "\n  train " in usage.stdout and "stress" not in usage.stdout
    assert refused.returncode == 2 and "Traceback" not in refused.stderr
    assert "`gscore stress` is not part of this installation" in refused.stderr


def test_pip_accepts_the_wheel(package: Path, tmp_path: Path) -> None:
    """Oracle: pip, which checks name, tag and metadata; hashes of the files it wrote."""
    with zipfile.ZipFile(package) as archive:
        (name,) = [n for n in archive.namelist() if n.startswith("wheels/gscore-")]
        archive.extract(name, tmp_path)
    there = tmp_path / "there"
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target", there]
    subprocess.run([*pip, tmp_path / name], check=True)
    with zipfile.ZipFile(tmp_path / name) as wheel:
        (record,) = [n for n in wheel.namelist() if n.endswith("/RECORD")]
        rows = [line.split(",") for line in wheel.read(record).decode().splitlines()]
        assert {row[0] for row in rows} == set(wheel.namelist())
    for path, stated, _ in rows:
        if stated:
            digest = hashlib.sha256((there / path).read_bytes()).digest()
            assert stated == "sha256=" + base64.urlsafe_b64encode(digest).decode().rstrip("=")
    libraries = [path for path, *_ in rows if Path(path).suffix in {".so", ".dll", ".dylib"}]
    names = sorted(Path(path).stem.removeprefix("lib") for path in libraries)
    assert names == ["gscore", "gscore_gpu"]


def test_installs_and_cycles(package: Path, run_blender: Callable[..., str]) -> None:
    """Oracle: Blender's types and operators; where Python found the modules; a clean exit."""
    output = run_blender(INSTALL + CYCLE, package)
    places = [line.split(" ", 1)[1] for line in output.splitlines() if line.startswith("FROM")]
    assert len(places) == 2
    assert all("extensions" in place and str(ROOT) not in place for place in places), places
    assert "CARDS [" in output and "CLEAN" in output


def test_updates_in_a_running_session(
    package: Path, run_blender: Callable[..., str], tmp_path: Path
) -> None:
    """Oracle: a mark in the newer wheel, whose version is the same to the user."""
    newer = tmp_path / "newer.zip"
    with zipfile.ZipFile(package) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    (name,) = [n for n in members if n.startswith("wheels/gscore-")]
    marked = _marked(members.pop(name), Path(name).name, tmp_path)
    members[f"wheels/{marked.name}"] = marked.read_bytes()
    stated = members["blender_manifest.toml"].decode()
    members["blender_manifest.toml"] = stated.replace(Path(name).name, marked.name).encode()
    build_extension.write_zip(newer, members)
    assert "UPDATED" in run_blender(INSTALL + UPDATE, newer, package)


def _marked(wheel: bytes, name: str, folder: Path) -> Path:
    """A copy of this wheel with one more line of source, built by the tool."""
    project, version, *_, tag = Path(name).stem.split("-")
    plain = version.split("+")[0]
    parts, libraries = {}, {}
    with zipfile.ZipFile(io.BytesIO(wheel)) as archive:
        for entry in archive.namelist():
            data = archive.read(entry)
            if entry.endswith((".so", ".dll", ".dylib")):
                libraries[Path(entry).name] = folder / Path(entry).name
                libraries[Path(entry).name].write_bytes(data)
                continue
            if entry.endswith("METADATA"):
                data = data.replace(version.encode(), plain.encode(), 1)
            parts[entry.replace(version, plain, 1)] = data
    parts["gscore/_version.py"] += b"MARK = 1\n"
    bare = folder / f"{project}-{plain}-py3-none-any.whl"
    build_extension.write_zip(bare, parts)
    made = build_extension.add_libraries(bare, libraries, tag, folder)
    assert made.name != name
    return made


def test_uninstalls(package: Path, run_blender: Callable[..., str]) -> None:
    """Oracle: Blender's preferences and types, and the folder of its unpacked wheels."""
    assert "GONE" in run_blender(INSTALL + UNINSTALL, package)
