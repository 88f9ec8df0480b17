"""Extension index: makes a folder of extension zips a repository for Blender.

`python tools/build/extension_index.py FOLDER --base URL` lets Blender's own program write the index
(`blender --command extension server-generate`, or the same program from the bpy module where no
Blender is installed), and makes its addresses whole: zips of a release lie elsewhere than the
index does.
"""

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path

import bpy_venvs
from told import told

VERSION = "v1"
"""Of the format of the index."""
_NEEDED = ("id", "version", "platforms", "archive_url", "archive_size", "archive_hash")


def command(folder: Path) -> list[str | Path]:
    """The program that writes the index of a folder."""
    options = ["server-generate", f"--repo-dir={folder}"]
    if program := shutil.which("blender"):
        return [program, "--command", "extension", *options]
    version = (bpy_venvs.installed() or [bpy_venvs.choose("newest")[0]])[-1]
    packages = bpy_venvs.ensure(version).parent.parent
    return [sys.executable, next(packages.rglob("bl_pkg/cli/blender_ext.py")), *options]


def checked(index: dict, zips: list[Path]) -> list[dict]:
    """The entries of an index, one a zip.

    Raises:
        RuntimeError: a zip is missing in it, two are for one platform, or a field is.
    """
    entries = index.get("data", [])
    if index.get("version") != VERSION or len(entries) != len(zips):
        raise RuntimeError(
            f"the index is of version {index.get('version')} with {len(entries)} entries; "
            f"{VERSION} with {len(zips)} was expected"
        )
    platforms = [name for entry in entries for name in entry.get("platforms", [])]
    if len(set(platforms)) != len(platforms):
        raise RuntimeError(f"two zips are for one platform: {', '.join(sorted(platforms))}")
    for entry in entries:
        if lost := [name for name in _NEEDED if not entry.get(name)]:
            raise RuntimeError(f"{entry.get('archive_url')}: the index lacks {', '.join(lost)}")
    return entries


@told
def main() -> None:
    """Write the index and say what is in it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="of the zips")
    parser.add_argument("--base", default="", help="address that the zips lie below; none: beside")
    options = parser.parse_args()
    zips = sorted(options.folder.glob("*.zip"))
    if not zips:
        parser.error(f"{options.folder} holds no zip; make some: make extension PLATFORMS=all")
    subprocess.run(command(options.folder), check=True)
    path = options.folder / "index.json"
    index = json.loads(path.read_text(encoding="utf-8"))
    for entry in checked(index, zips):
        if options.base:
            name = entry["archive_url"].removeprefix("./")
            entry["archive_url"] = f"{options.base.rstrip('/')}/{name}"
        print(f"{', '.join(entry['platforms'])}: {entry['archive_url']}")
    path.write_text(json.dumps(index, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
