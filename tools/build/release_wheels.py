"""Release wheels for all of Blender's platforms, built into dist/ on any of them.

`python tools/build/release_wheels.py` builds all with zig; names such as `linux-x64` select some.
A later `make extension PLATFORMS=all` reuses the compiled libraries.
"""

import argparse
import sys
from pathlib import Path

import build_extension
import native_builds
from error_exit import exit_with_message


@exit_with_message
def main() -> None:
    """Build the wheels and print their paths."""
    known = list(native_builds.PLATFORMS)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("platforms", nargs="*", metavar="PLATFORM", help=", ".join(known))
    parser.add_argument("--output", type=Path, default=build_extension.ROOT / "dist")
    options = parser.parse_args()
    platforms = options.platforms or known
    if unknown := [name for name in platforms if name not in known]:
        parser.error(f"{', '.join(unknown)}: choose some of {', '.join(known)}")
    builds = build_extension.compile_all(platforms)
    plain, _ = build_extension.build_wheels()
    options.output.mkdir(parents=True, exist_ok=True)
    for libraries, tag in builds.values():
        path = build_extension.add_libraries(
            plain, libraries, tag, options.output, for_blender=False
        )
        print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    sys.exit(main())
