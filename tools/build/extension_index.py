"""Extension index: turns a folder of extension zips into a repository for Blender.

`python tools/build/extension_index.py FOLDER --base URL` writes the index with Blender's own
program (`blender --command extension server-generate`, or that of the bpy module if no Blender is
installed), and completes its addresses, because the zips of a release are not next to the index.
"""

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path

import bpy_venvs
from error_exit import exit_with_message

VERSION = "v1"
"""Version of the index format."""
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
    """The entries of an index, one per zip.

    Raises:
        RuntimeError: a zip or field is missing, or two zips are for one platform.
    """
    entries = index.get("data", [])
    if index.get("version") != VERSION or len(entries) != len(zips):
        raise RuntimeError(
            f"the index has version {index.get('version')} and {len(entries)} entries; "
            f"expected {VERSION} and {len(zips)}"
        )
    platforms = [name for entry in entries for name in entry.get("platforms", [])]
    if len(set(platforms)) != len(platforms):
        raise RuntimeError(f"two zips are for one platform: {', '.join(sorted(platforms))}")
    for entry in entries:
        if missing := [name for name in _NEEDED if not entry.get(name)]:
            raise RuntimeError(f"{entry.get('archive_url')}: the index lacks {', '.join(missing)}")
    return entries


@exit_with_message
def main() -> None:
    """Write the index and print its entries."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="folder of the zips")
    parser.add_argument("--base", default="", help="base URL of the zips; default: relative")
    options = parser.parse_args()
    zips = sorted(options.folder.glob("*.zip"))
    if not zips:
        parser.error(f"{options.folder} contains no zip; run: make extension PLATFORMS=all")
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
