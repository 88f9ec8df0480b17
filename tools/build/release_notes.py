"""Release notes from CHANGELOG.md, and a check that the tag matches the version of all packages.

`python tools/build/release_notes.py v1.2.3 --output notes.md` writes the section of that version.
"""

import argparse
import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def versions() -> dict[str, str]:
    """The stated version by file."""
    text = (ROOT / "gscore" / "_version.py").read_text(encoding="utf-8")
    (package,) = re.findall(r'^__version__ = "([^"]+)"', text, flags=re.MULTILINE)
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    return {"gscore/_version.py": package, "blender_manifest.toml": manifest["version"]}


def section(changelog: str, version: str) -> str:
    """The section of a version in CHANGELOG.md, without its heading; empty: none."""
    found = re.search(
        rf"^## \[?{re.escape(version)}(?![.\d])\]?[^\n]*\n(.*?)(?=^## |\Z)",
        changelog,
        flags=re.MULTILINE | re.DOTALL,
    )
    return found[1].strip() if found else ""


def main() -> int:
    """Check the tag and write the notes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tag", help="the version with a leading v")
    parser.add_argument("--output", type=Path, required=True)
    options = parser.parse_args()
    released = options.tag.removeprefix("v")
    for file, version in versions().items():
        if version != released or not options.tag.startswith("v"):
            print(f"The tag is {options.tag}, {file} states {version}.", file=sys.stderr)
            return 1
    notes = section((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), released)
    if not notes:
        print(f"CHANGELOG.md has no section ## {released}.", file=sys.stderr)
        return 1
    options.output.write_text(notes + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
